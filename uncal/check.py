"""Looks for the usual mistakes in recordings: ``python -m uncal.check ROOT``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from uncal.settings.configuration import exits_on_error, quiet_libraries

DESCRIPTION = """\
Looks for the usual mistakes in recordings of any supported layout (KITTI raw, KITTI odometry, DSEC,
plain folder, bag or MCAP): inverted extrinsic, swapped axes or handedness, millimetres for metres,
degrees for radians, a camera matrix of another resolution, distortion left in, clocks that differ
or frames in another order, a rotation that is none, points already in the camera's frame, mirrored
images, truncated or empty files, drives without scans, missing calibration.

What concerns geometry is told by the data: edges of the sweeps, projected under the suspected fault
and under its repair, against edges of the images."""

EPILOG = """\
Exit status: 0 no error, 1 at least one error (or the folder cannot be read), 2 wrong usage.

Examples:
  python -m uncal.check /data/kitti
  python -m uncal.check /data/my_rig --camera front --json"""


@exits_on_error
def main(arguments: Sequence[str] | None = None) -> None:
    """Check, print, and end with status 1 if there is an error.

    Args:
        arguments: of the command line; None takes the process's own.
    """
    given = parser().parse_args(arguments)
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.checking.check import check
    from uncal.checking.report import as_json, as_table

    quiet_libraries()
    overlays = None if given.no_overlays else given.overlays
    checked = check(given.root, given.camera, given.frames, overlays, quiet=given.json)
    sys.stdout.write((as_json if given.json else as_table)(given.root, checked) + "\n")
    if any(finding.error for finding in checked.findings):
        raise SystemExit(1)


def at_least_one(text: str) -> int:
    """A count on the command line."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number of at least 1")
    return int(text)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command_line = argparse.ArgumentParser(
        prog="python -m uncal.check",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command_line.add_argument(
        "root", type=Path, metavar="ROOT", help="folder of the recordings, or bag"
    )
    command_line.add_argument(
        "--camera",
        help="image folder, side of an event camera, or topic (default: the first recorded)",
    )
    command_line.add_argument(
        "--frames",
        type=at_least_one,
        default=8,
        help="frames of each drive to compare (default: 8)",
    )
    command_line.add_argument(
        "--overlays",
        type=Path,
        default=Path("outputs/check"),
        metavar="FOLDER",
        help="where a picture of each drive goes (default: outputs/check)",
    )
    command_line.add_argument("--no-overlays", action="store_true", help="write no pictures")
    command_line.add_argument("--json", action="store_true", help="for machines")
    return command_line


if __name__ == "__main__":
    main()
