"""Simulate recordings: ``python -m uncal.simulate root=data/my_sim simulation.n_rigs=5``."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import hydra
from omegaconf import DictConfig, OmegaConf

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error
from uncal.settings.help_page import show_help

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="simulate")
@exits_on_error
def main(config: DictConfig) -> None:
    """Simulate, or find what an earlier run simulated, and say what is where."""
    # Here and not above: they take time, which --help has no use for.
    from uncal.settings.check import check_settings
    from uncal.simulation.settings import SimulationSettings
    from uncal.simulation.writer import ensure_simulated

    check_settings(config)
    plain = OmegaConf.to_container(config.simulation, resolve=True)
    settings = SimulationSettings.from_mapping(cast(Mapping[str, object], plain))
    root = ensure_simulated(settings, Path(config.root), config.workers, config.progress)
    size = sum(file.stat().st_size for file in root.rglob("*") if file.is_file())
    log.info(
        "%d rigs, %d drives, %d frames, %.0f MB: %s",
        settings.n_rigs,
        settings.n_rigs * settings.drives_per_rig,
        settings.n_frames,
        size / 1e6,
        root.resolve(),
    )


if __name__ == "__main__":
    show_help("simulate.yaml")
    quote_arguments()
    main()
