"""Good recordings in DSEC's layout, broken in each of the ways that a check should find."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from breaking import Faults, Matrix, distort, geometric, of_files
from uncal.recordings.calibration_files import event_camera_calibration
from uncal.recordings.dsec_layout import find_sequences
from uncal.recordings.lidar_bag import LidarBag
from uncal.simulation.formats.dsec_files import LidarScan, write_lidar_bag

_HOUR_US = 3_600_000_000


def dsec_faults() -> Faults:
    """Name of a fault → its kind, and what puts it into a DSEC folder.

    Under the names of :func:`breaking_kitti.kitti_faults`. What is not here cannot be: events are
    one stream, whose order is that of their times, and have no other size than the sensor.
    """
    return {
        **geometric(_lidar_yaml, _points, _camera_frame, _event_K),
        "images (events) mirrored": ("mirrored", lambda root: _map(root, _mirrored)),
        "distortion k1 = -0.3": ("distortion", lambda root: _map(root, _distorted)),
        "images (events) one frame late": ("clock", lambda root: _offset(root, 400_000)),
        "clocks an hour apart": ("clock", lambda root: _offset(root, _HOUR_US)),
        "time stamps run backwards": ("clock", _backwards),
        **of_files("events.h5", "events.h5", "*.bag", "lidar_imu.bag", "cam_to_cam.yaml"),
    }


def _lidar_yaml(root: Path, change: Callable[[Matrix], Matrix]) -> None:
    for path in root.rglob("cam_to_lidar.yaml"):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content["T_lidar_camRect1"] = change(np.array(content["T_lidar_camRect1"], float)).tolist()
        path.write_text(yaml.safe_dump(content), encoding="utf-8")


def _event_K(root: Path, scale: float) -> None:
    for path in root.rglob("cam_to_cam.yaml"):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        camera = content["intrinsics"]["camRect0"]
        camera["camera_matrix"] = [scale * float(value) for value in camera["camera_matrix"]]
        path.write_text(yaml.safe_dump(content), encoding="utf-8")


def _points(root: Path, matrix: Matrix, shift: Matrix | None = None) -> None:
    """Write the bag of every drive anew."""
    for path in root.rglob("lidar_imu.bag"):
        bag = LidarBag(path)
        scans = [_scan(bag, i, matrix, shift) for i in range(len(bag.index))]
        path.unlink()
        write_lidar_bag(path, scans)


def _scan(bag: LidarBag, i: int, matrix: Matrix, shift: Matrix | None) -> LidarScan:
    points, _ = bag.read(i)
    points[:, :3] = points[:, :3] @ matrix.T + (0.0 if shift is None else shift)
    points[:, 3] *= 255
    n = len(points)
    ring, time = np.zeros(n, np.uint16), np.zeros(n, np.float32)
    return LidarScan(int(bag.index.stamp_ns[i]), points, ring, time)


def _camera_frame(root: Path) -> None:
    for folder in find_sequences(root).values():
        calibration = event_camera_calibration(folder.cam_to_cam, folder.cam_to_lidar)
        T = calibration.T_cam_lidar
        _points(folder.bag.parent, T[:3, :3], T[:3, 3])


def _map(root: Path, change: Callable[[Matrix, Matrix], Matrix]) -> None:
    """Change where the events of every pixel are, given (H, W, 2) and K."""
    for folder in find_sequences(root).values():
        K = event_camera_calibration(folder.cam_to_cam, folder.cam_to_lidar).K
        with h5py.File(folder.of_camera("left", "rectify_map.h5"), "r+") as file:
            file["rectify_map"][...] = change(file["rectify_map"][()].astype(np.float64), K)


def _mirrored(rectified: Matrix, _: Matrix) -> Matrix:
    return np.stack([rectified.shape[1] - 1 - rectified[..., 0], rectified[..., 1]], -1)


def _distorted(rectified: Matrix, K: Matrix) -> Matrix:
    return distort(rectified.reshape(-1, 2), K).reshape(rectified.shape)


def _offset(root: Path, microseconds: int) -> None:
    for path in root.rglob("events.h5"):
        with h5py.File(path, "r+") as file:
            file["t_offset"][()] = int(file["t_offset"][()]) + microseconds


def _backwards(root: Path) -> None:
    """The last event first."""
    for path in root.rglob("events.h5"):
        with h5py.File(path, "r+") as file:
            times: NDArray[np.uint32] = file["events/t"][()]
            file["events/t"][...] = times[::-1]
