"""Writes the files of a DSEC sequence: events, rectification map, calibrations and LiDAR bag.

The layout is that of https://dsec.ifi.uzh.ch/data-format/, as far as a LiDAR and the left event
camera need it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import hdf5plugin
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros1_noetic as ros

CAMERAS = 4
"""DSEC's cameras: 0 event left, 1 frame left, 2 frame right, 3 event right."""

_CLOUD = "sensor_msgs/msg/PointCloud2"

_FLOAT32, _UINT16 = 7, 4
"""Types of sensor_msgs/PointField."""

POINT_FIELDS = (
    ("x", "<f4", _FLOAT32),
    ("y", "<f4", _FLOAT32),
    ("z", "<f4", _FLOAT32),
    ("intensity", "<f4", _FLOAT32),
    ("ring", "<u2", _UINT16),
    ("time", "<f4", _FLOAT32),
)
"""Fields of a point in the Velodyne driver's order."""

POINT = np.dtype([(name, dtype) for name, dtype, _ in POINT_FIELDS])
"""One point as that driver packs it: 22 bytes, no padding."""


@dataclass(frozen=True)
class DsecCamera:
    """One camera of the rig, before and after rectification.

    Attributes:
        K: (3, 3) camera matrix of the sensor, pixels.
        K_rect: (3, 3) camera matrix of the rectified image, pixels.
        R_rect: (3, 3) rotation, camera → rectified camera.
        size: (H, W), pixels.
        distortion: k1, k2, p1, p2 of the sensor, radial-tangential.
    """

    K: NDArray[np.float64]
    K_rect: NDArray[np.float64]
    R_rect: NDArray[np.float64]
    size: tuple[int, int]
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LidarScan:
    """One revolution of the LiDAR.

    Attributes:
        time_ns: UNIX time of the header, ns: the start of the revolution.
        points: (N, 4) float32 x, y, z in metres in the LiDAR frame, and intensity, 0..255.
        ring: (N,) uint16 beam, counted from the lowest.
        time: (N,) float32 seconds after ``time_ns``.
    """

    time_ns: int
    points: NDArray[np.float32]
    ring: NDArray[np.uint16]
    time: NDArray[np.float32]


def write_events(
    path: Path,
    x: NDArray[np.integer],  # (n,) column, pixels
    y: NDArray[np.integer],  # (n,) row, pixels
    t_us: NDArray[np.integer],  # (n,) microseconds after t_offset, in order
    p: NDArray[np.integer] | NDArray[np.bool_],  # (n,) whether the pixel became brighter
    t_offset: int,  # microseconds
) -> None:
    """Write ``events.h5``, compressed with Blosc (Zstandard) as DSEC's.

    ``ms_to_idx[ms]`` is the first event with t ≥ 1000·ms, for every whole millisecond up to the
    last event.

    Raises:
        ValueError: no events, lengths differ, times out of order, or a value that its type in the
            file cannot hold.
    """
    if not len(t_us) or not len(x) == len(y) == len(t_us) == len(p):
        raise ValueError(
            f"{len(x)} x, {len(y)} y, {len(t_us)} t_us and {len(p)} p; expected as many of each, "
            "and at least one event"
        )
    if np.any(t_us[1:] < t_us[:-1]):
        raise ValueError("t_us is not in order; sort the events by time")
    milliseconds = 1000 * np.arange(int(t_us[-1]) // 1000 + 1)
    ms_to_idx = np.searchsorted(t_us, milliseconds, side="left")
    datasets: dict[str, NDArray[np.generic]] = {
        "events/x": _as_type("x", x, np.uint16),
        "events/y": _as_type("y", y, np.uint16),
        "events/t": _as_type("t_us", t_us, np.uint32),
        "events/p": _as_type("p", p, np.uint8),
        "ms_to_idx": ms_to_idx.astype(np.uint64),
    }
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            _write_dataset(file, name, values)
        file.create_dataset("t_offset", data=np.int64(t_offset), track_times=False)


def write_rectify_map(path: Path, rectify_map: NDArray[np.float32]) -> None:
    """Write ``rectify_map.h5``: (H, W, 2), at [y, x] the rectified x and y of a sensor's pixel."""
    if rectify_map.ndim != 3 or rectify_map.shape[2] != 2:
        raise ValueError(f"rectify_map has shape {rectify_map.shape}; expected (H, W, 2)")
    with h5py.File(path, "w") as file:
        _write_dataset(file, "rectify_map", rectify_map.astype(np.float32))


def write_cam_to_cam(
    path: Path,
    cameras: Sequence[DsecCamera],  # event left, frame left, frame right, event right
    T_10: NDArray[np.float64],  # (4, 4) event left → frame left, m
    T_21: NDArray[np.float64],  # (4, 4) frame left → frame right, m
    T_32: NDArray[np.float64],  # (4, 4) frame right → event right, m
) -> None:
    """Write ``cam_to_cam.yaml``: intrinsics and extrinsics of four cameras before rectification."""
    if len(cameras) != CAMERAS:
        raise ValueError(f"{len(cameras)} cameras; DSEC has {CAMERAS}")
    intrinsics: dict[str, dict[str, object]] = {}
    for index, camera in enumerate(cameras):
        intrinsics[f"cam{index}"] = {
            **_pinhole(camera.K, camera.size),
            "distortion_model": "radtan",
            "distortion_coeffs": [float(value) for value in camera.distortion],
        }
        intrinsics[f"camRect{index}"] = _pinhole(camera.K_rect, camera.size)
    extrinsics = {"T_10": T_10.tolist(), "T_21": T_21.tolist(), "T_32": T_32.tolist()}
    extrinsics |= {f"R_rect{i}": camera.R_rect.tolist() for i, camera in enumerate(cameras)}
    _write_yaml(path, {"intrinsics": intrinsics, "extrinsics": extrinsics})


def write_cam_to_lidar(path: Path, T_lidar_camRect1: NDArray[np.float64]) -> None:
    """Write ``cam_to_lidar.yaml``: (4, 4) rectified left frame camera → LiDAR, m."""
    _write_yaml(path, {"T_lidar_camRect1": T_lidar_camRect1.tolist()})


def write_lidar_bag(path: Path, scans: Iterable[LidarScan]) -> None:
    """Write ``lidar_imu.bag``, without the IMU: a ROS 1 bag of sensor_msgs/PointCloud2.

    Raises:
        ValueError: a scan whose arrays differ in length.
        rosbags.rosbag1.WriterError: ``path`` exists.
    """
    store = get_typestore(Stores.ROS1_NOETIC)
    offsets = np.cumsum([0] + [np.dtype(dtype).itemsize for _, dtype, _ in POINT_FIELDS])
    fields = [
        ros.sensor_msgs__msg__PointField(name, int(offset), code, 1)
        for (name, _, code), offset in zip(POINT_FIELDS, offsets, strict=False)
    ]
    with Writer(path) as bag:
        connection = bag.add_connection("/velodyne_points", _CLOUD, typestore=store)
        for index, scan in enumerate(scans):
            packed = _pack(scan)
            stamp = ros.builtin_interfaces__msg__Time(*divmod(scan.time_ns, 10**9))
            cloud = ros.sensor_msgs__msg__PointCloud2(
                header=ros.std_msgs__msg__Header(index, stamp, "velodyne"),
                height=1,
                width=len(packed),
                fields=fields,
                is_bigendian=False,
                point_step=POINT.itemsize,
                row_step=packed.nbytes,
                data=packed.view(np.uint8),
                is_dense=bool(np.isfinite(scan.points[:, :3]).all()),
            )
            serialized = store.serialize_ros1(cloud, _CLOUD)
            bag.write(connection, scan.time_ns, serialized)


def _pack(scan: LidarScan) -> NDArray[np.void]:
    n = len(scan.points)
    if scan.points.shape != (n, 4) or len(scan.ring) != n or len(scan.time) != n:
        raise ValueError(
            f"scan at {scan.time_ns} ns: points {scan.points.shape}, {len(scan.ring)} rings, "
            f"{len(scan.time)} times; expected (N, 4), N and N"
        )
    packed = np.empty(n, POINT)
    for column, name in enumerate(("x", "y", "z", "intensity")):
        packed[name] = scan.points[:, column]
    packed["ring"], packed["time"] = scan.ring, scan.time
    return packed


def _as_type(
    name: str,
    values: NDArray[np.integer] | NDArray[np.bool_],
    dtype: type[np.uint8] | type[np.uint16] | type[np.uint32],
) -> NDArray[np.unsignedinteger]:
    largest = 1 if name == "p" else np.iinfo(dtype).max
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > largest:
        raise ValueError(f"{name} spans {low}..{high}; the file holds 0..{largest}")
    return values.astype(dtype)


def _write_dataset(file: h5py.File, name: str, values: NDArray[np.generic]) -> None:
    # No times of creation: the same simulation must give the same bytes.
    file.create_dataset(
        name, data=values, chunks=True, track_times=False, **hdf5plugin.Blosc(cname="zstd")
    )


def _pinhole(K: NDArray[np.float64], size: tuple[int, int]) -> dict[str, object]:
    height, width = size
    return {
        "camera_model": "pinhole",
        "camera_matrix": [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])],
        "resolution": [int(width), int(height)],
    }


def _write_yaml(path: Path, content: dict[str, object]) -> None:
    with path.open("w") as file:
        yaml.safe_dump(content, file, sort_keys=False, default_flow_style=None)
