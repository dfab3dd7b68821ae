"""A converted drive is there whole, with what could be read, or not at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.bag_conversion import write_folder
from uncal.recordings.bag_stream import BagStream, Observation
from uncal.recordings.plain_folder import PlainFolder

K = np.array([[40.0, 0.0, 20.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]])


class Bag:
    """Three pairs, then what an error leaves of a bag."""

    def __init__(self, ends_with: BaseException | None, n: int = 3) -> None:
        self.path = Path("drive.bag")
        self.ends_with, self.n = ends_with, n
        self.lens = SimpleNamespace(K_undistorted=K, size=(24, 40))
        self.counts: Counter[str] = Counter(images=n, scans=n)
        self.reasons: Counter[str] = Counter()

    def __iter__(self) -> Iterator[Observation]:
        for i in range(self.n):
            image = np.full((24, 40, 3), i, np.uint8)
            yield Observation(image, np.ones((5, 4), np.float32), K, float(i), float(i), 0)
        if self.ends_with is not None:
            raise self.ends_with


def convert(
    root: Path, ends_with: BaseException | None = None, n: int = 3, drive: str = "a", x: float = 0.0
) -> Path:
    T = np.eye(4)
    T[0, 3] = x
    bag = cast(BagStream, Bag(ends_with, n))
    return write_folder(bag, root, drive, "camera", "lidar", T, progress=False)


def names(root: Path) -> set[str]:
    return {path.name for path in root.iterdir()} if root.exists() else set()


def test_a_damaged_bag_leaves_the_pairs_before_the_damage(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"torn\. The 3 frames before that are in .*a\.$"):
        convert(tmp_path, RecordingError("drive.bag: torn."))
    assert names(tmp_path) == {"rig.yaml", "a"}
    assert len(PlainFolder(tmp_path).frame_ids) == 3


@pytest.mark.parametrize("stopped", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_what_is_stopped_leaves_nothing_and_can_be_given_again(
    tmp_path: Path, stopped: BaseException
) -> None:
    with pytest.raises(type(stopped)):
        convert(tmp_path, stopped, x=1.0)
    assert names(tmp_path) == set()
    # Killed, it leaves what the next one takes away; and another extrinsic is no other rig.
    (tmp_path / ".a.partial" / "camera").mkdir(parents=True)
    convert(tmp_path, x=2.0)
    assert names(tmp_path) == {"rig.yaml", "a"}
    convert(tmp_path, drive="b", x=2.0)
    assert len(PlainFolder(tmp_path).frame_ids) == 6
    with pytest.raises(ConfigurationError, match="of another rig"):
        convert(tmp_path, drive="c", x=3.0)


def test_a_bag_without_pairs_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not one pair"):
        convert(tmp_path, n=0)
    assert names(tmp_path) == set()


@pytest.mark.parametrize(
    ("camera", "lidar", "said"),
    [
        ("a/b", "lidar", "camera=a/b: expected the name of a folder"),
        ("camera", "../x", r"lidar=\.\./x: expected the name of a folder"),
        ("top", "top", "camera=top, lidar=top: each needs a folder"),
    ],
)
def test_sensors_are_folders_of_the_drive(
    tmp_path: Path, camera: str, lidar: str, said: str
) -> None:
    with pytest.raises(ConfigurationError, match=said):
        write_folder(cast(BagStream, Bag(None)), tmp_path / "r", "a", camera, lidar, np.eye(4))
    assert names(tmp_path) == set()


@pytest.mark.parametrize("drive", ["../b", "a/b", "", ".", ".hidden"])
def test_a_drive_is_a_folder_of_the_root(tmp_path: Path, drive: str) -> None:
    with pytest.raises(ConfigurationError, match="expected the name of a folder"):
        convert(tmp_path / "root", drive=drive)
    assert names(tmp_path) == set()


def test_a_killed_conversion_is_no_drive(tmp_path: Path) -> None:
    convert(tmp_path)
    (tmp_path / ".b.partial" / "camera").mkdir(parents=True)
    assert {frame.drive for frame in PlainFolder(tmp_path).frame_ids} == {"a"}
