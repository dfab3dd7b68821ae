"""A plain folder from a bag: ``python -m uncal.convert source=drive.mcap root=data/my_rig``."""

from __future__ import annotations

import logging
from pathlib import Path

import hydra
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error
from uncal.settings.help_page import show_help

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="convert")
@exits_on_error
def main(config: DictConfig) -> None:
    """Convert, and say what became a frame and what did not."""
    # Here and not above: they take time, which --help has no use for.
    from uncal.recordings.bag_conversion import read_extrinsic, write_folder
    from uncal.recordings.bag_stream import BagStream
    from uncal.settings.check import check_settings

    check_settings(config)
    source, root = Path(config.source), Path(config.root)
    topics = config.topics
    with BagStream(
        source, topics.image, topics.points, topics.camera_info, config.tolerance_s, config.offset_s
    ) as stream:
        T = stream.T_cam_lidar if config.extrinsic is None else read_extrinsic(config.extrinsic)
        drive = config.drive or source.name.removesuffix(source.suffix)
        folder = write_folder(
            stream, root, drive, config.camera, config.lidar, T, config.every, config.progress
        )
        for what, n in stream.counts.items():
            log.info("%s: %d", what, n)
        for reason, n in stream.reasons.most_common(3):
            log.info("  unreadable (%d): %s", n, reason)
    log.info("%s\nnext: python -m uncal.check %s", folder.resolve(), root)


if __name__ == "__main__":
    show_help("convert.yaml")
    quote_arguments()
    main()
