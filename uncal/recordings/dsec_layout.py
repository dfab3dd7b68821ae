"""Where DSEC's files are: the sequences side by side, the LiDAR per drive.

::

    <root>/zurich_city_04_a/events/left/{events.h5, rectify_map.h5}          left or right
    <root>/zurich_city_04_a/calibration/{cam_to_cam.yaml, cam_to_lidar.yaml}
    <root>/data/zurich_city_04/{lidar_imu.bag, cam_to_lidar.yaml}            lidar_imu.zip

The sequences may also be in ``<root>/train`` and ``<root>/test``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from uncal.errors import RecordingError
from uncal.recordings.folder_listing import contents, existing, subfolders

REMEDY = """\
Expected the DSEC layout:
  {root}/zurich_city_04_a/events/left/events.h5 and rectify_map.h5
  {root}/zurich_city_04_a/calibration/cam_to_cam.yaml and cam_to_lidar.yaml
  {root}/data/zurich_city_04/lidar_imu.bag
Get the events, the calibration and lidar_imu.zip from \
https://dsec.ifi.uzh.ch/dsec-datasets/download/, or simulate a stand-in:
  python -m uncal.simulate simulation=event_street root=data/dsec_standin
and read it with dataset=dsec dataset.root=data/dsec_standin"""

_PARENTS = ("", "train", "test")
_PARTS = ("events", "calibration")


def _named(letters_of_drive: dict[str, str]) -> tuple[str, ...]:
    return tuple(f"{drive}_{x}" for drive, letters in letters_of_drive.items() for x in letters)


TRAIN: tuple[str, ...] = _named(
    {
        "thun_00": "a",
        "interlaken_00": "cdefg",
        "zurich_city_00": "ab",
        "zurich_city_01": "abcdef",
        "zurich_city_02": "abcde",
        "zurich_city_03": "a",
        "zurich_city_04": "abcdef",
        "zurich_city_05": "ab",
        "zurich_city_06": "a",
        "zurich_city_07": "a",
        "zurich_city_08": "a",
        "zurich_city_09": "abcde",
        "zurich_city_10": "ab",
        "zurich_city_11": "abc",
    }
)
"""The official training sequences."""

TEST: tuple[str, ...] = _named(
    {
        "thun_01": "ab",
        "interlaken_00": "ab",
        "interlaken_01": "a",
        "zurich_city_12": "a",
        "zurich_city_13": "ab",
        "zurich_city_14": "abc",
        "zurich_city_15": "a",
    }
)
"""The official test sequences; interlaken_00 was driven once and is in both lists."""

_LETTER = re.compile(r"(.+)_[a-z]")


def drive_of(sequence: str) -> str:
    """The drive that a sequence is a part of: its name without the letter.

    It was recorded in one go with one LiDAR file, and cut into ``zurich_city_04_a`` ... ``_f``.

    >>> drive_of("zurich_city_04_a")
    'zurich_city_04'
    """
    match = _LETTER.fullmatch(sequence)
    return match[1] if match else sequence


@dataclass(frozen=True)
class SequenceFolder:
    """The files of one sequence, there or not.

    Attributes:
        root: folder of the whole data set.
        path: folder of the sequence.
    """

    root: Path
    path: Path

    @property
    def name(self) -> str:
        """Name of the sequence."""
        return self.path.name

    @property
    def bag(self) -> Path:
        """The LiDAR's file of the drive."""
        return self.root / "data" / drive_of(self.name) / "lidar_imu.bag"

    @property
    def cam_to_cam(self) -> Path:
        """The cameras' calibration."""
        return self.path / "calibration" / "cam_to_cam.yaml"

    @property
    def cam_to_lidar(self) -> Path:
        """The LiDAR's calibration: the sequence's own, else the one beside the bag."""
        own = self.path / "calibration" / "cam_to_lidar.yaml"
        return own if own.exists() else self.bag.with_name("cam_to_lidar.yaml")

    def of_camera(self, side: str, name: str) -> Path:
        """``events.h5`` or ``rectify_map.h5`` of the left or right event camera."""
        return self.path / "events" / side / name


def find_sequences(root: Path) -> dict[str, SequenceFolder]:
    """The sequences under the folder of a data set: name → folder, sorted by name.

    Raises:
        RecordingError: there is no such folder, or no sequence in it.
    """
    existing(root, REMEDY)
    found: dict[str, SequenceFolder] = {}
    for parent in (root / name for name in _PARENTS):
        for name in subfolders(parent) if parent.is_dir() else []:
            if any((parent / name / part).is_dir() for part in _PARTS):
                found.setdefault(name, SequenceFolder(root, parent / name))
    if found:
        return dict(sorted(found.items()))
    if any((root / part).is_dir() for part in _PARTS):
        raise RecordingError(f"{root} is itself a sequence: give its parent, {root.parent}.")
    raise RecordingError(
        f"{root} holds no sequence folder such as zurich_city_04_a; found {contents(root)}. "
        f"{REMEDY.format(root=root)}"
    )
