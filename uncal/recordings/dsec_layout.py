"""Where DSEC's files are: the sequences side by side, the LiDAR per drive.

::

    <root>/zurich_city_04_a/events/left/{events.h5, rectify_map.h5}          left or right
    <root>/zurich_city_04_a/calibration/{cam_to_cam.yaml, cam_to_lidar.yaml}
    <root>/data/zurich_city_04/{lidar_imu.bag, cam_to_lidar.yaml}            lidar_imu.zip

The sequences may also be in ``<root>/train`` and ``<root>/test``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uncal.errors import RecordingError
from uncal.recordings.dsec_sequences import drive_of
from uncal.recordings.folder_listing import contents, subfolders

_PARENTS = ("", "train", "test")
_PARTS = ("events", "calibration")


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

    def events(self, side: str) -> Path:
        """The events of one camera."""
        return self.path / "events" / side / "events.h5"

    def rectify_map(self, side: str) -> Path:
        """The rectification of one event camera."""
        return self.path / "events" / side / "rectify_map.h5"


def find_sequences(root: Path) -> dict[str, SequenceFolder]:
    """The sequences under the folder of a data set: name → folder, sorted by name.

    Raises:
        RecordingError: there is no such folder, or no sequence in it.
    """
    if not root.is_dir():
        raise RecordingError(f"The recordings folder {root} does not exist. {remedy(root)}")
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
        f"{remedy(root)}"
    )


def remedy(root: Path) -> str:
    """What to do about a folder that is not DSEC's, for an error message."""
    return (
        "Expected the DSEC layout:\n"
        f"  {root}/zurich_city_04_a/events/left/events.h5 and rectify_map.h5\n"
        f"  {root}/zurich_city_04_a/calibration/cam_to_cam.yaml and cam_to_lidar.yaml\n"
        f"  {root}/data/zurich_city_04/lidar_imu.bag\n"
        "Get the events, the calibration and lidar_imu.zip from "
        "https://dsec.ifi.uzh.ch/dsec-datasets/download/, or simulate a stand-in:\n"
        "  python -m uncal.simulate simulation=event_street root=data/dsec_standin\n"
        "and read it with dataset=dsec dataset.root=data/dsec_standin"
    )
