"""Intervals for a user's own rig: ``python -m uncal.calibrate weights=unical recordings=ROOT``."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import hydra
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.guard import task_words
from uncal.settings.help_page import show_help

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="calibrate")
@exits_on_error
def main(config: DictConfig) -> None:
    """Calibrate the intervals on a trusted extrinsic, or find a first one.

    Args:
        config: conf/calibrate.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.calibrating.trusted import calibrate
    from uncal.calibrating.untrusted import find_first
    from uncal.errors import ConfigurationError
    from uncal.evaluate import chosen_weights
    from uncal.settings.check import check_settings
    from uncal.system.disk import check_writable

    quiet_libraries()
    check_settings(config)
    out = Path(config.out)
    if out.suffix != ".safetensors":
        raise ConfigurationError(f"out={out}: expected a name that ends in .safetensors")
    weights = chosen_weights(config.weights, config.ckpt)
    check_writable(out)
    config.dataset.root = config.recordings
    if config.trusted:
        lines = calibrate(config, task_words(), weights, out)
    else:
        lines = find_first(config, weights, out.with_suffix(""))
    for line in lines:
        log.info("%s", line)


@exits_on_error
def with_layout(words: Sequence[str]) -> list[str]:
    """The command line with the dataset that the layout of the recordings is read by.

    Args:
        words: of the command line.

    >>> with_layout(["recordings=ROOT", "dataset=kitti"])
    ['recordings=ROOT', 'dataset=kitti']
    """
    from uncal.recordings.folder_listing import layout_of

    given = dict(word.split("=", 1) for word in words if "=" in word)
    if "dataset" in given or "recordings" not in given:
        return list(words)
    layout = layout_of(Path(given["recordings"].strip("'\"")).expanduser(), "recordings")
    return [*words, f"dataset={layout}"]


if __name__ == "__main__":
    show_help("calibrate.yaml")
    sys.argv[1:] = with_layout(sys.argv[1:])
    quote_arguments()
    main()
