from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.data.dataset import FrameDataset, Sample
from uncal.errors import FrameError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.kitti import KittiRaw
from uncal.recordings.motion import REVOLUTION_S, read_oxts, untwisted

DRIVE = "2011_09_26_drive_0001_sync"


def measured(world: NDArray[np.float64], twist: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a moving LiDAR reports points that stand still, found by iteration."""
    seen = np.array(world, np.float64)
    for _ in range(50):
        delay = -np.arctan2(seen[:, 1], seen[:, 0]) / (2 * np.pi) * REVOLUTION_S
        for i, t in enumerate(delay):
            angle = np.linalg.norm(twist[3:]) * t
            axis = twist[3:] / max(float(np.linalg.norm(twist[3:])), 1e-12)
            v = world[i] - twist[:3] * t
            turned = (
                v * np.cos(-angle)
                + np.cross(axis, v) * np.sin(-angle)
                + axis * (axis @ v) * (1 - np.cos(angle))
            )
            seen[i] = turned
    return seen


def test_a_still_world_is_still_again() -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform([3, -20, -2], [40, 20, 3], (200, 3))
    twist = np.array([14.0, 0.5, 0.1, 0.0, 0.0, 0.3])
    seen = measured(world, twist)
    assert np.abs(seen - world).max() > 0.3
    rows = np.column_stack([seen, np.full(200, 0.5)]).astype(np.float32)
    back = untwisted(rows, twist)
    assert np.abs(back[:, :3] - world).max() < 0.01
    np.testing.assert_array_equal(back[:, 3], rows[:, 3])


def write_oxts(root: Path, velocity: tuple[float, float, float]) -> Path:
    folder = root / "2011_09_26" / DRIVE / "oxts" / "data"
    folder.mkdir(parents=True)
    numbers = np.zeros(30)
    numbers[8:11] = velocity
    for index in range(4):
        (folder / f"{index:010d}.txt").write_text(" ".join(map(str, numbers)))
    return folder


def test_kitti_raw_reads_how_the_vehicle_moves(kitti_raw_root: Path) -> None:
    write_oxts(kitti_raw_root, (9.0, 0.0, 0.0))
    recording = KittiRaw(kitti_raw_root)
    frame = recording.load(recording.frame_ids[1])
    assert frame.twist is not None
    np.testing.assert_allclose(np.linalg.norm(frame.twist[:3]), 9.0, rtol=1e-4)
    other = recording.load(recording.frame_ids[-1])
    assert other.twist is None, "a drive without oxts is read as it is"
    as_it_is = KittiRaw(kitti_raw_root, untwist=False)
    assert as_it_is.load(recording.frame_ids[1]).twist is None


def test_a_damaged_record_of_motion_is_named(kitti_raw_root: Path) -> None:
    folder = write_oxts(kitti_raw_root, (9.0, 0.0, 0.0))
    (folder / "0000000001.txt").write_text("49.0 8.4")
    (folder / "0000000002.txt").write_text("49.0 eight")
    (folder / "0000000003.txt").unlink()
    recording = KittiRaw(kitti_raw_root)
    for index in (1, 2, 3):
        with pytest.raises(FrameError, match=rf"{index:010d}\.txt.*untwist=false"):
            recording.load(recording.frame_ids[index])


def test_the_imu_may_be_turned_against_the_lidar(tmp_path: Path) -> None:
    numbers = np.zeros(30)
    numbers[8], numbers[22] = 10.0, 0.2
    path = tmp_path / "0.txt"
    path.write_text(" ".join(map(str, numbers)))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    twist = read_oxts(path, quarter)
    np.testing.assert_allclose(twist, [0.0, 10.0, 0.0, 0.0, 0.0, 0.2], atol=1e-12)


def test_points_and_edges_of_a_sample_are_untwisted(kitti_raw_root: Path) -> None:
    write_oxts(kitti_raw_root, (15.0, 0.0, 0.0))
    samples = []
    for untwist in (True, False):
        recording = KittiRaw(kitti_raw_root, untwist=untwist)
        dataset = FrameDataset(
            recording,
            [(recording.frame_ids[0],)],
            (64, 128),
            DecalibrationRange(1.0, 10.0),
            0,
            False,
        )
        sample = dataset[0][0]
        assert isinstance(sample, Sample)
        samples.append(sample)
    moved, plain = samples
    n = min(len(moved.points), len(plain.points))
    assert n > 0
    assert not np.allclose(moved.points[:n], plain.points[:n])
