"""Tiny files of the DSEC layout, written with h5py, rosbags and yaml alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import hdf5plugin
import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

_TYPES = get_typestore(Stores.ROS1_NOETIC)
_POINT_FIELD_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_IMU, _CLOUD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2"

VLP16 = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 22,
    }
)
SCAN_MS, SWEEP_MS = 50, 45
HEIGHT, WIDTH = 6, 8
START_US = 50_000_000_000  # time of day
DRIVE_START_NS = 18_500 * 86_400_000_000_000 + 1000 * START_US


def rectify_map() -> NDArray[np.float32]:
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    return np.stack([x + 0.25 * y - 0.5, 1.5 * y - 0.125 * x], axis=-1)


@pytest.fixture(scope="session")
def make_scan() -> Callable[..., NDArray[np.void]]:
    """Five points of a sweep: x = number, 1..5 m; times from 0 to the sweep's end."""

    def make(number: int, dtype: np.dtype[np.void] = VLP16) -> NDArray[np.void]:
        points = np.zeros(5, dtype=dtype)
        points["x"], points["y"], points["z"] = number, np.arange(5) + 1, -2
        points["intensity"] = [0, 51, 102, 153, 255]
        if "time" in (dtype.names or ()):
            points["time"] = np.linspace(0, SWEEP_MS / 1000, 5)
        return points

    return make


@pytest.fixture(scope="session")
def make_cloud() -> Callable[..., object]:
    """A PointCloud2 of a structured array: the fields are those of its dtype."""

    def make(points: NDArray[np.void], stamp_ns: int = 0, rows: int = 1, gap: int = 0) -> object:
        dtype, message = points.dtype, _TYPES.types
        assert dtype.fields is not None
        fields = []
        for name in dtype.names or ():
            kind, offset = dtype.fields[name][:2]
            number = _POINT_FIELD_TYPES[kind.str[1:]]
            fields.append(message["sensor_msgs/msg/PointField"](name, offset, number, 1))
        width = len(points) // rows
        raw = np.frombuffer(points.tobytes(), np.uint8).reshape(rows, -1)
        data = np.pad(raw, ((0, 0), (0, gap)), constant_values=0xFF)
        time = message["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return message[_CLOUD](
            header=message["std_msgs/msg/Header"](0, time, "velodyne"),
            height=rows,
            width=width,
            fields=fields,
            is_bigendian=dtype.fields["x"][0].byteorder == ">",
            point_step=dtype.itemsize,
            row_step=data.shape[1],
            data=data.reshape(-1),
            is_dense=True,
        )

    return make


@pytest.fixture(scope="session")
def write_bag(make_cloud: Callable[..., object]) -> Callable[..., None]:
    """Write a bag of (stamp, points) scans, recorded 3 ms after their stamp, between IMU data."""

    def write(
        path: Path,
        scans: Sequence[tuple[int, NDArray[np.void]]],
        topic: str = "/velodyne_points",
        chunk_bytes: int = 800,
        compression: str = "LZ4",
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        writer = Writer(path)
        writer.set_compression(Writer.CompressionFormat[compression])
        with writer:
            writer.chunk_threshold = chunk_bytes
            imu = writer.add_connection("/imu/data", _IMU, typestore=_TYPES)
            lidar = writer.add_connection(topic, _CLOUD, typestore=_TYPES)
            for stamp_ns, points in scans:
                _write(writer, imu, stamp_ns + 1_000_000, _imu_message())
                _write(writer, lidar, stamp_ns + 3_000_000, make_cloud(points, stamp_ns))

    return write


@pytest.fixture(scope="session")
def write_events() -> Callable[..., None]:
    """Write events.h5 and rectify_map.h5: ``t`` as given, pixels and polarities by turns."""

    def write(
        folder: Path,
        t: NDArray[np.int64],
        t_offset: int,
        coordinate: str = "u2",
        time: str = "u4",
        chunk: int = 64,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        number = np.arange(len(t))
        columns = {
            "x": (number % WIDTH).astype(coordinate),
            "y": (number // WIDTH % HEIGHT).astype(coordinate),
            "t": t.astype(time),
            "p": (number % 3 == 0).astype("u1"),
        }
        of_ms = [int(np.sum(t < 1000 * ms)) for ms in range(int(t[-1]) // 1000 + 1)]
        with h5py.File(folder / "events.h5", "w") as file:
            for name, values in columns.items():
                file.create_dataset(
                    f"events/{name}", data=values, chunks=(chunk,), **hdf5plugin.Blosc(cname="zstd")
                )
            file["ms_to_idx"] = np.array(of_ms, dtype="u8")
            file["t_offset"] = np.int64(t_offset)
        with h5py.File(folder / "rectify_map.h5", "w") as file:
            file["rectify_map"] = rectify_map()

    return write


@pytest.fixture(scope="session")
def write_calibration() -> Callable[..., None]:
    """Write cam_to_cam.yaml and cam_to_lidar.yaml of axis-parallel cameras, or as given."""

    def write(folder: Path, lidar_x: float = 0.4, extrinsics: object = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        baseline = np.eye(4)
        baseline[0, 3] = -0.05
        same = np.eye(3).tolist()
        T_lidar_camRect1 = [[0, 0, 1, lidar_x], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
        cameras = {
            "intrinsics": {
                name: {"camera_matrix": [5.0 + i, 6.0 + i, 3.5, 2.5], "resolution": [8, 6]}
                for i, name in enumerate(("camRect0", "camRect1", "camRect2", "camRect3"))
            },
            "extrinsics": extrinsics
            or {
                **{name: baseline.tolist() for name in ("T_10", "T_21", "T_32")},
                **{f"R_rect{number}": same for number in range(4)},
            },
        }
        (folder / "cam_to_cam.yaml").write_text(yaml.safe_dump(cameras))
        (folder / "cam_to_lidar.yaml").write_text(
            yaml.safe_dump({"T_lidar_camRect1": T_lidar_camRect1})
        )

    return write


@pytest.fixture
def add_sequence(
    tmp_path: Path, write_events: Callable[..., None], write_calibration: Callable[..., None]
) -> Callable[..., None]:
    """300 ms of events, one every 100 µs, ``start_ms`` after the drive's beginning."""

    def add(name: str, start_ms: int = 0, side: str = "left", lidar_x: float = 0.4) -> None:
        folder = tmp_path / name / "events" / side
        write_events(folder, np.arange(0, 300_000, 100), START_US + 1000 * start_ms)
        write_calibration(tmp_path / name / "calibration", lidar_x=lidar_x)

    return add


@pytest.fixture
def add_bag(
    tmp_path: Path, make_scan: Callable[..., NDArray[np.void]], write_bag: Callable[..., None]
) -> Callable[..., Path]:
    """Scans at 20 Hz from the drive's beginning on; each sweep takes 45 ms."""

    def add(drive: str, numbers: list[int] | None = None, start_ns: int | None = None) -> Path:
        path = tmp_path / "data" / drive / "lidar_imu.bag"
        begin = DRIVE_START_NS if start_ns is None else start_ns
        scans = [(begin + 1_000_000 * SCAN_MS * i, make_scan(i)) for i in numbers or range(13)]
        write_bag(path, scans)
        return path

    return add


@pytest.fixture
def dsec_root(
    tmp_path: Path, add_sequence: Callable[..., None], add_bag: Callable[..., Path]
) -> Path:
    """Two sequences of one drive, 0 to 300 and 300 to 600 ms, and a drive of another rig."""
    add_sequence("sim_00_a")
    add_sequence("sim_00_b", start_ms=300)
    add_sequence("sim_01_a", lidar_x=0.5)
    add_bag("sim_00")
    add_bag("sim_01")
    return tmp_path


def _write(writer: Writer, connection: Connection, time_ns: int, message: object) -> None:
    writer.write(connection, time_ns, bytes(_TYPES.serialize_ros1(message, connection.msgtype)))


def _imu_message() -> object:
    message, nothing = _TYPES.types, np.zeros(9)
    zero = message["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    time = message["builtin_interfaces/msg/Time"](0, 0)
    return message[_IMU](
        header=message["std_msgs/msg/Header"](0, time, "imu"),
        orientation=message["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        orientation_covariance=nothing,
        angular_velocity=zero,
        angular_velocity_covariance=nothing,
        linear_acceleration=zero,
        linear_acceleration_covariance=nothing,
    )
