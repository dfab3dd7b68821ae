from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import hdf5plugin
import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros1_noetic import sensor_msgs__msg__PointCloud2 as PointCloud2

from uncal.simulation.formats.dsec_files import (
    DsecCamera,
    LidarScan,
    write_cam_to_cam,
    write_cam_to_lidar,
    write_events,
    write_lidar_bag,
    write_rectify_map,
)

Integers = NDArray[np.int64]
BLOSC = str(hdf5plugin.Blosc.filter_id)
START_NS = 1_600_000_000_999_999_999


def times_with_gaps() -> Integers:
    """Bursts and silences, events on the millisecond, ties, and none in the first 3 ms."""
    rng = np.random.default_rng(0)
    bursts = [rng.integers(3_200, 9_000, 500), rng.integers(50_000, 51_500, 500)]
    return np.sort(np.concatenate([*bursts, [7_000, 7_000, 60_000, 60_000]]))


def events_of(t: Integers) -> tuple[Integers, Integers, Integers, Integers]:
    index = np.arange(len(t))
    return index % 640, index % 480, t, index % 2


def test_events_read_back_in_the_types_of_dsec(tmp_path: Path) -> None:
    x, y, t, p = events_of(times_with_gaps())
    write_events(tmp_path / "events.h5", x, y, t, p, 41_234_567_890)
    with h5py.File(tmp_path / "events.h5", "r") as file:
        for name, values, dtype in (
            ("x", x, np.uint16),
            ("y", y, np.uint16),
            ("t", t, np.uint32),
            ("p", p, np.uint8),
        ):
            dataset = file["events"][name]
            assert dataset.dtype == dtype
            assert BLOSC in dataset._filters
            np.testing.assert_array_equal(dataset[()], values)
        assert file["t_offset"][()] == 41_234_567_890
        assert file["t_offset"].dtype == np.int64
        assert file["t_offset"].shape == ()
        assert file["ms_to_idx"].dtype == np.uint64


def test_ms_to_idx_finds_the_first_event_of_every_millisecond(tmp_path: Path) -> None:
    write_events(tmp_path / "events.h5", *events_of(times_with_gaps()), 0)
    with h5py.File(tmp_path / "events.h5", "r") as file:
        t, ms_to_idx = file["events/t"][()].astype(int), file["ms_to_idx"][()].astype(int)
    assert len(ms_to_idx) == 61
    assert ms_to_idx[0] == 0
    for ms, index in enumerate(ms_to_idx):
        assert t[index] >= 1000 * ms
        assert index == 0 or t[index - 1] < 1000 * ms


def test_ms_to_idx_by_hand(tmp_path: Path) -> None:
    t = np.array([0, 999, 1000, 1000, 3500])
    write_events(tmp_path / "events.h5", *events_of(t), 0)
    with h5py.File(tmp_path / "events.h5", "r") as file:
        assert file["ms_to_idx"][()].tolist() == [0, 2, 4, 4]


def test_the_same_events_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first.h5", "second.h5"):
        write_events(tmp_path / name, *events_of(times_with_gaps()), 5)
    assert (tmp_path / "first.h5").read_bytes() == (tmp_path / "second.h5").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda x, y, t, p: (x[:-1], y, t, p), "as many of each"),
        (lambda x, y, t, p: (x[:0], y[:0], t[:0], p[:0]), "at least one event"),
        (lambda x, y, t, p: (x, y, t[::-1], p), "sort the events"),
        (lambda x, y, t, p: (x - 1, y, t, p), r"x spans -1\.\."),
        (lambda x, y, t, p: (x, y + 65_536, t, p), r"y spans 65536\.\..*0\.\.65535"),
        (lambda x, y, t, p: (x, y, t + 2**32, p), "t_us spans"),
        (lambda x, y, t, p: (x, y, t, 2 * p - 1), r"p spans -1\.\.1"),
    ],
)
def test_events_that_the_file_cannot_hold_are_refused(
    tmp_path: Path,
    change: Callable[..., tuple[Integers, Integers, Integers, Integers]],
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message):
        write_events(tmp_path / "events.h5", *change(*events_of(times_with_gaps())), 0)
    assert not (tmp_path / "events.h5").exists()


def test_rectify_map_reads_back(tmp_path: Path) -> None:
    rectify_map = np.random.default_rng(0).normal(size=(6, 8, 2)).astype(np.float32)
    write_rectify_map(tmp_path / "rectify_map.h5", rectify_map)
    with h5py.File(tmp_path / "rectify_map.h5", "r") as file:
        assert file["rectify_map"].dtype == np.float32
        np.testing.assert_array_equal(file["rectify_map"][()], rectify_map)
    with pytest.raises(ValueError, match=r"\(8, 2\); expected \(H, W, 2\)"):
        write_rectify_map(tmp_path / "rectify_map.h5", rectify_map[0])


def camera(number: int) -> DsecCamera:
    K = np.array([[500.5 + number, 0, 320], [0, 501, 240.25], [0, 0, 1]])
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) * (number + 1)
    size = (480, 640) if number in (0, 3) else (1080, 1440)
    return DsecCamera(K, K + 0.125, R, size, (-0.1, 0.01, 0.0, 1e-4))


def test_cam_to_cam_reads_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    T_10, T_21, T_32 = rng.normal(size=(3, 4, 4))
    write_cam_to_cam(tmp_path / "cam_to_cam.yaml", [camera(i) for i in range(4)], T_10, T_21, T_32)
    content = yaml.safe_load((tmp_path / "cam_to_cam.yaml").read_text())
    intrinsics, extrinsics = content["intrinsics"], content["extrinsics"]
    assert list(intrinsics) == [f"{kind}{i}" for i in range(4) for kind in ("cam", "camRect")]
    assert intrinsics["cam0"]["camera_matrix"] == [500.5, 501.0, 320.0, 240.25]
    assert intrinsics["cam0"]["distortion_coeffs"] == [-0.1, 0.01, 0.0, 1e-4]
    assert intrinsics["camRect1"]["camera_matrix"] == [501.625, 501.125, 320.125, 240.375]
    assert intrinsics["camRect0"]["resolution"] == [640, 480]
    assert intrinsics["camRect2"]["resolution"] == [1440, 1080]
    for name, expected in (("T_10", T_10), ("T_21", T_21), ("T_32", T_32)):
        np.testing.assert_array_equal(extrinsics[name], expected)
    for number in range(4):
        np.testing.assert_array_equal(extrinsics[f"R_rect{number}"], camera(number).R_rect)


def test_cam_to_cam_needs_four_cameras(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="2 cameras; DSEC has 4"):
        write_cam_to_cam(tmp_path / "c.yaml", [camera(0), camera(1)], *[np.eye(4)] * 3)


def test_cam_to_lidar_reads_back_every_bit(tmp_path: Path) -> None:
    T = np.random.default_rng(0).normal(size=(4, 4))
    write_cam_to_lidar(tmp_path / "cam_to_lidar.yaml", T)
    content = yaml.safe_load((tmp_path / "cam_to_lidar.yaml").read_text())
    np.testing.assert_array_equal(content["T_lidar_camRect1"], T)


def scan(number: int, n: int) -> LidarScan:
    rng = np.random.default_rng(number)
    return LidarScan(
        time_ns=START_NS + number * 100_000_000,
        points=rng.uniform(-50, 255, (n, 4)).astype(np.float32),
        ring=rng.integers(0, 16, n).astype(np.uint16),
        time=np.linspace(0, 0.1, n, dtype=np.float32),
    )


def test_lidar_bag_reads_back(tmp_path: Path) -> None:
    scans = [scan(0, 70_000), scan(1, 1), scan(2, 0)]
    write_lidar_bag(tmp_path / "lidar_imu.bag", iter(scans))
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(tmp_path / "lidar_imu.bag") as bag:
        found = list(bag.messages())
    assert len(found) == len(scans)
    for expected, (connection, bag_ns, raw) in zip(scans, found, strict=True):
        assert connection.topic == "/velodyne_points"
        assert connection.msgtype == "sensor_msgs/msg/PointCloud2"
        message = store.deserialize_ros1(raw, connection.msgtype)
        assert isinstance(message, PointCloud2)
        stamp = message.header.stamp
        assert bag_ns == stamp.sec * 10**9 + stamp.nanosec == expected.time_ns
        assert message.header.frame_id == "velodyne"
        layout = [(field.name, field.offset, field.datatype) for field in message.fields]
        assert layout == [
            ("x", 0, 7),
            ("y", 4, 7),
            ("z", 8, 7),
            ("intensity", 12, 7),
            ("ring", 16, 4),
            ("time", 18, 7),
        ]
        assert (message.height, message.width) == (1, len(expected.points))
        assert (message.point_step, message.row_step) == (22, 22 * len(expected.points))
        assert not message.is_bigendian
        assert message.is_dense
        rows = message.data.reshape(-1, 22)
        columns = rows[:, :16].copy().view("<f4").reshape(-1, 4)
        np.testing.assert_array_equal(columns, expected.points)
        np.testing.assert_array_equal(rows[:, 16:18].copy().view("<u2").ravel(), expected.ring)
        np.testing.assert_array_equal(rows[:, 18:].copy().view("<f4").ravel(), expected.time)


def test_a_scan_with_missing_rings_is_refused(tmp_path: Path) -> None:
    whole = scan(0, 5)
    broken = LidarScan(whole.time_ns, whole.points, whole.ring[:-1], whole.time)
    with pytest.raises(ValueError, match="4 rings, 5 times; expected"):
        write_lidar_bag(tmp_path / "lidar_imu.bag", [broken])
