"""Does the monitor work? ``python -m uncal.monitor.experiment weights=unical +sweeps=monitor``."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.guard import task_words


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="monitor")
@exits_on_error
def main(config: DictConfig) -> None:
    """Measure all cases and show the page.

    Args:
        config: conf/monitor.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.monitor.experiment.run import run_experiment
    from uncal.reporting.run_record import command_line
    from uncal.settings.check import check_settings
    from uncal.system.memory import keep_freed_memory

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    hydra_config = HydraConfig.get()
    folder = Path(hydra_config.runtime.output_dir)
    command = command_line("uncal.monitor.experiment", task_words())
    sys.stdout.write(f"\n{run_experiment(config, folder, command)}\n{folder}/monitor.md\n")


if __name__ == "__main__":
    quote_arguments()
    main()
