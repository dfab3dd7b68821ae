"""One graph for a vehicle: ``python -m uncal.export weights=unical format=onnx out=FILE``."""

from __future__ import annotations

import logging
from pathlib import Path

import hydra
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.help_page import show_help

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="export")
@exits_on_error
def main(config: DictConfig) -> None:
    """Write the graph, and the file that finds the edges of a sweep.

    Args:
        config: conf/export.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.evaluate import chosen_weights
    from uncal.exporting.writer import write_graph
    from uncal.settings.check import check_settings

    quiet_libraries()
    check_settings(config)
    written = write_graph(
        chosen_weights(config.weights, config.ckpt),
        Path(config.out),
        config.format,
        tuple(config.image_size),
        None if config.levels is None else list(config.levels),
        config.mask_seed,
    )
    for path in written:
        log.info("%s (%.2f MB)", path, path.stat().st_size / 1e6)


if __name__ == "__main__":
    show_help("export.yaml")
    quote_arguments()
    main()
