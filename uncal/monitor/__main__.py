"""Estimate, interval and verdict per frame: ``python -m uncal.monitor weights=… source=…``."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.help_page import show_help

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="monitor")
@exits_on_error
def main(config: DictConfig) -> None:
    """Watch a stream, or make the references that this needs.

    Args:
        config: conf/monitor.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.monitor.run import calibrate, chosen, watch
    from uncal.settings.check import check_settings
    from uncal.system.memory import keep_freed_memory

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    task = calibrate if chosen(config) == "calibrate" else watch
    folder = Path(HydraConfig.get().runtime.output_dir)
    sys.stdout.write(f"\n{task(config, folder)}\n")


if __name__ == "__main__":
    show_help("monitor.yaml")
    quote_arguments()
    main()
