"""Recordings of the event camera: DSEC's files, read plainly and by the reader of real ones."""

from __future__ import annotations

import datetime
import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped]
import hdf5plugin  # noqa: F401  # registers Blosc
import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from uncal.recordings.dsec import Dsec
from uncal.simulation import writer
from uncal.simulation.formats.dsec_folder import sweep_times
from uncal.simulation.manifest import LOCK_NAME, Manifest
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]
DAY_US = 86_400_000_000


@pytest.fixture
def root(event_simulation: Path, tmp_path: Path) -> Path:
    """A copy that the test may change."""
    return Path(shutil.copytree(event_simulation, tmp_path / "root"))


def contents(root: Path) -> dict[str, bytes]:
    """All files but the lock and the index that the reader leaves beside a bag."""
    files = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(f.relative_to(root)): f.read_bytes() for f in files if f.name[0] != "."}


def messages(bag: Path) -> list[tuple[int, NDArray[np.float32], NDArray[np.uint16]]]:
    """Stamp in ns, points and rings of every scan."""
    store = get_typestore(Stores.ROS1_NOETIC)
    found = []
    with Reader(bag) as reader:
        for connection, _, raw in reader.messages():
            assert connection.topic == "/velodyne_points"
            cloud: Any = store.deserialize_ros1(raw, connection.msgtype)
            rows = cloud.data.reshape(-1, 22)
            stamp = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
            points = rows[:, :16].copy().view("<f4").reshape(-1, 4)
            assert not rows[:, 18:].any(), "the sweep is taken at one moment"
            found.append((stamp, points, rows[:, 16:18].copy().view("<u2").ravel()))
    return found


def test_layout_is_dsecs(event_simulation: Path) -> None:
    files = {name for name in contents(event_simulation) if "_0001" in name}
    sequence = {
        "events/left/events.h5",
        "events/left/rectify_map.h5",
        "calibration/cam_to_cam.yaml",
        "calibration/cam_to_lidar.yaml",
        "images/timestamps.txt",
    }
    assert files == {f"sim_0001_{letter}/{name}" for letter in "ab" for name in sequence} | {
        "data/sim_0001/lidar_imu.bag",
        "data/sim_0001/cam_to_lidar.yaml",
    }
    assert {entry.name for entry in event_simulation.iterdir() if entry.is_dir()} == {
        *("data", "sim_0000_a", "sim_0000_b", "sim_0001_a", "sim_0001_b")
    }


def test_manifest_names_every_folder(
    event_simulation: Path, event_settings: SimulationSettings
) -> None:
    manifest = json.loads((event_simulation / "simulation.json").read_text())
    assert manifest["finished"] is True
    assert manifest["n_frames"] == 12
    assert manifest["dates"][:3] == ["data/sim_0000", "sim_0000_a", "sim_0000_b"]
    assert SimulationSettings.from_mapping(manifest["settings"]) == event_settings


def test_calibration_files_give_the_true_extrinsic(
    event_simulation: Path, event_settings: SimulationSettings
) -> None:
    for index in range(2):
        folder = event_simulation / f"sim_000{index}_b" / "calibration"
        cameras = yaml.safe_load((folder / "cam_to_cam.yaml").read_text())
        lidar = yaml.safe_load((folder / "cam_to_lidar.yaml").read_text())
        extrinsics = cameras["extrinsics"]
        R_rect0, R_rect1 = np.eye(4), np.eye(4)
        R_rect0[:3, :3], R_rect1[:3, :3] = extrinsics["R_rect0"], extrinsics["R_rect1"]
        T_camRect1_camRect0 = R_rect1 @ np.array(extrinsics["T_10"]) @ np.linalg.inv(R_rect0)
        T_lidar_camRect0 = np.array(lidar["T_lidar_camRect1"]) @ T_camRect1_camRect0
        rig = draw_rig(event_settings, index)
        np.testing.assert_allclose(np.linalg.inv(T_lidar_camRect0), rig.T_cam_lidar, atol=1e-9)
        fx, fy, cx, cy = cameras["intrinsics"]["camRect0"]["camera_matrix"]
        np.testing.assert_array_equal(rig.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        assert cameras["intrinsics"]["cam0"]["resolution"] == [64, 24]
        beside = event_simulation / "data" / f"sim_000{index}" / "cam_to_lidar.yaml"
        assert yaml.safe_load(beside.read_text()) == lidar


def test_events_lie_in_the_windows_before_the_sweeps(
    event_simulation: Path, event_settings: SimulationSettings
) -> None:
    for sequence, letter in enumerate("ab"):
        with h5py.File(event_simulation / f"sim_0000_{letter}/events/left/events.h5") as file:
            t = file["events/t"][()].astype(np.int64) + file["t_offset"][()]
            x, y, p = (file[f"events/{name}"][()] for name in "xyp")
        ends = sweep_times(event_settings, sequence)
        assert np.diff(ends).tolist() == [400_000, 400_000]
        per_window = [int(((t >= end - 50_000) & (t < end)).sum()) for end in ends]
        # All but the two that mark the ends of the sequence.
        assert sum(per_window) == len(t) - 2
        assert (t[0], t[-1]) == (ends[0] - 60_000, ends[-1] + 10_000)
        assert min(per_window) > 200
        assert (x.max(), y.max()) == (63, 23)
        assert 0.3 < p.mean() < 0.7


def test_the_bag_has_the_sweeps_of_all_sequences_on_the_unix_clock(
    event_simulation: Path, event_settings: SimulationSettings
) -> None:
    scans = messages(event_simulation / "data/sim_0001/lidar_imu.bag")
    expected = np.concatenate([sweep_times(event_settings, sequence) for sequence in range(2)])
    stamps = np.array([stamp for stamp, _, _ in scans])
    assert (stamps % 1000 == 0).all()
    assert (stamps // 1000 % DAY_US).tolist() == expected.tolist()
    day = datetime.datetime.fromtimestamp(stamps[0] / 1e9, datetime.timezone.utc)
    assert (day.year, day.month, day.day, day.hour) == (2001, 1, 2, 8)
    elevations = draw_rig(event_settings, 1).elevations
    for _, points, ring in scans:
        assert len(points) > 100
        assert 100 < points[:, 3].max() <= 255
        flat = np.hypot(points[:, 0], points[:, 1])
        np.testing.assert_allclose(np.arctan2(points[:, 2], flat), elevations[ring], atol=1e-5)


def test_bytes_depend_on_the_seed_and_not_on_the_processes(
    make_event_settings: MakeSettings,
    event_settings: SimulationSettings,
    event_simulation: Path,
    tmp_path: Path,
) -> None:
    ensure_simulated(event_settings, tmp_path / "again", workers=1, progress=False)
    before = contents(event_simulation)
    assert contents(tmp_path / "again") == before
    ensure_simulated(
        make_event_settings(n_rigs=2, drives_per_rig=2, frames_per_drive=3, seed=1),
        tmp_path / "other",
        workers=2,
        progress=False,
    )
    after = contents(tmp_path / "other")
    assert after.keys() == before.keys()
    same = {Path(name).name for name in before if before[name] == after[name]}
    assert same == {"timestamps.txt"}


def test_long_sequences_are_put_together_from_pieces(
    make_event_settings: MakeSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "PIECE_FRAMES", 2)
    settings = make_event_settings(n_rigs=1, frames_per_drive=5)
    ensure_simulated(settings, tmp_path / "root", workers=2, progress=False)
    recording = Dsec(tmp_path / "root", window_ms=50.0, min_events=100)
    assert [frame_id.index for frame_id in recording.frame_ids] == [0, 1, 2, 3, 4]
    assert len(messages(tmp_path / "root/data/sim_0000/lidar_imu.bag")) == 5


def test_an_interrupted_simulation_is_resumed(
    event_settings: SimulationSettings,
    event_simulation: Path,
    root: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    # Cut short while the second rig's folders were moving: its LiDAR is there, a sequence is not.
    (root / ".partial_0001").mkdir()
    (root / "sim_0001_b").rename(root / ".partial_0001" / "sim_0001_b")
    Manifest.of(event_settings, finished=False).write(root)
    kept = {path: path.stat().st_mtime_ns for path in root.glob("sim_0000_*/events/left/*.h5")}
    assert len(kept) == 4
    with caplog.at_level(logging.WARNING):
        ensure_simulated(event_settings, root, workers=1, progress=False)
    assert "1 of 2 rigs are simulated again" in caplog.text
    assert contents(root) == contents(event_simulation)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_a_finished_simulation_is_reused(
    event_settings: SimulationSettings, root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        ensure_simulated(event_settings, root, progress=False)
    assert "reusing the simulation" in caplog.text


@pytest.mark.parametrize("left", [[], ["thesis.tex"]])
def test_the_other_layout_replaces_it_and_nothing_else(
    make_settings: MakeSettings, root: Path, left: list[str]
) -> None:
    for name in left:
        (root / "data" / name).write_text("precious")
    pictures = make_settings(n_rigs=1, frames_per_drive=1)
    ensure_simulated(pictures, root, workers=1, progress=False)
    entries = {entry.name for entry in root.iterdir()} - {LOCK_NAME}
    assert entries == {"2041_01_01", "simulation.json", *(["data"] if left else [])}
    assert [path.name for path in root.glob("data/*")] == left
