"""Good recordings, broken in each of the ways that a check should find; for tests and tables.

Each function changes a copy of a KITTI raw or DSEC folder in place.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import h5py  # type: ignore[import-untyped]
import numpy as np
import torch
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.geometry import euler_to_matrix, matrix_to_euler
from uncal.recordings.calibration_files import read_calibration_file
from uncal.recordings.kitti import KittiRaw

Break = Callable[[Path], None]


def kitti_faults() -> dict[str, tuple[str, Break]]:
    """Name of a fault → its kind, and what puts it into a KITTI raw folder (camera image_02)."""
    return {
        "inverted extrinsic": ("inverted", lambda root: _velo(root, _inverse)),
        "axes: x right, y forward": ("axes", lambda root: _points(root, _XY)),
        "axes: y and z swapped": ("axes", lambda root: _points(root, _YZ)),
        "handedness: y to the right": ("axes", lambda root: _points(root, np.diag([1.0, -1, 1]))),
        "points in the camera's frame": ("camera frame", _camera_frame),
        "images mirrored": ("mirrored", lambda root: _images(root, lambda im, _: im[:, ::-1])),
        "points in millimetres": ("millimetres", lambda root: _points(root, 1000 * np.eye(3))),
        "translation in millimetres": ("millimetres", lambda root: _velo(root, _millimetres)),
        "degrees taken for radians": ("degrees", lambda root: _velo(root, _degrees)),
        "K of half the size": ("resolution", lambda root: _K(root, 0.5)),
        "K of twice the size": ("resolution", lambda root: _K(root, 2.0)),
        "images resized, K kept": ("resolution", lambda root: _images(root, _smaller)),
        "distortion k1 = -0.3": ("distortion", lambda root: _images(root, _distorted)),
        "images one frame late": ("clock", lambda root: _order(root, lambda n: np.arange(n) - 1)),
        "images in another order": ("clock", lambda root: _order(root, _shuffled)),
        "time stamps run backwards": ("clock", _backwards),
        "rotation with a scale": ("rotation", lambda root: _velo(root, _scaled)),
        "image truncated": ("truncated", lambda root: _cut(_first(root, "*.png"), 0.6)),
        "scan truncated": ("truncated", lambda root: _cut(_first(root, "*.bin"), 0.6)),
        "scan empty": ("truncated", lambda root: _cut(_first(root, "*.bin"), 0.0)),
        "no scans": ("scans", lambda root: _remove(root, "velodyne_points")),
        "no calibration": ("calibration", lambda root: _remove(root, "calib_velo_to_cam.txt")),
    }


def dsec_faults() -> dict[str, tuple[str, Break]]:
    """The same for DSEC's layout; what its bag would have to be rewritten for is left out."""
    return {
        "inverted extrinsic": ("inverted", lambda root: _lidar_yaml(root, _inverse)),
        "translation in millimetres": ("millimetres", lambda root: _lidar_yaml(root, _millimetres)),
        "K of half the size": ("resolution", lambda root: _event_K(root, 0.5)),
        "K of twice the size": ("resolution", lambda root: _event_K(root, 2.0)),
        "events mirrored": ("mirrored", _mirror_events),
        "events 0.4 s late": ("clock", lambda root: _offset(root, 400_000)),
        "events an hour late": ("clock", lambda root: _offset(root, 3_600_000_000)),
        "rotation with a scale": ("rotation", lambda root: _lidar_yaml(root, _scaled)),
        "bag truncated": ("truncated", lambda root: _cut(_first(root, "*.bag"), 0.6)),
        "no scans": ("scans", lambda root: _remove(root, "lidar_imu.bag")),
        "no calibration": ("calibration", lambda root: _remove(root, "cam_to_cam.yaml")),
    }


_XY = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
_YZ = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def _millimetres(T: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.block([[T[:3, :3], 1000 * T[:3, 3:]], [T[3:]]])


def _scaled(T: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.block([[1.02 * T[:3, :3], T[:3, 3:]], [T[3:]]])


def _degrees(T: NDArray[np.float64]) -> NDArray[np.float64]:
    angles = matrix_to_euler(torch.from_numpy(T[:3, :3])).rad2deg()
    return np.block([[euler_to_matrix(angles).numpy(), T[:3, 3:]], [T[3:]]])


def _velo(root: Path, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
    for path in root.rglob("calib_velo_to_cam.txt"):
        known = read_calibration_file(path)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = known["R"], known["T"]
        T = change(T)
        lines = [f"{key}: {' '.join(f'{v:.12e}' for v in values.ravel())}"
                 for key, values in (("R", T[:3, :3]), ("T", T[:3, 3]))]  # fmt: skip
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _K(root: Path, scale: float) -> None:
    for path in root.rglob("calib_cam_to_cam.txt"):
        lines = []
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, numbers = line.partition(":")
            if key.startswith("S_rect"):
                continue
            if key.startswith("P_rect"):
                P = np.array([float(number) for number in numbers.split()]).reshape(3, 4)
                P[:2] *= scale
                line = f"{key}: {' '.join(f'{value:.9e}' for value in P.ravel())}"
            lines.append(line)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _points(
    root: Path, matrix: NDArray[np.float64], shift: NDArray[np.float64] | None = None
) -> None:
    for path in root.rglob("velodyne_points/data/*.bin"):
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[:, :3] = points[:, :3] @ matrix.T + (0.0 if shift is None else shift)
        points.tofile(path)


def _camera_frame(root: Path) -> None:
    for date in (path.parent for path in root.rglob("calib_velo_to_cam.txt")):
        recording = KittiRaw(root, drives=[f"{date.name}/*"])
        T = recording.calibration(recording.frame_ids[0]).T_cam_lidar
        _points(date, T[:3, :3], T[:3, 3])


def _inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.inv(T), np.float64)


def _images(root: Path, change: Callable[[NDArray[np.uint8], float], NDArray[np.uint8]]) -> None:
    for path in root.rglob("image_02/data/*.png"):
        image = np.asarray(cv2.imread(str(path)), np.uint8)
        known = read_calibration_file(path.parents[3] / "calib_cam_to_cam.txt")
        cv2.imwrite(str(path), np.ascontiguousarray(change(image, known["P_rect_02"][0, 0])))


def _smaller(image: NDArray[np.uint8], _: float) -> NDArray[np.uint8]:
    small = cv2.resize(image, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def _distorted(image: NDArray[np.uint8], focal: float) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2)
    lens = np.array([-0.3, 0.0, 0.0, 0.0])
    at = cv2.undistortPoints(grid.astype(np.float64), K, lens, P=K).reshape(height, width, 2)
    at = at.astype(np.float32)
    bent = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    return np.asarray(bent, np.uint8)


def _order(root: Path, order: Callable[[int], NDArray[np.intp]]) -> None:
    for folder in root.rglob("image_02/data"):
        paths = sorted(folder.glob("*.png"))
        contents = [path.read_bytes() for path in paths]
        for path, source in zip(paths, order(len(paths)), strict=True):
            path.write_bytes(contents[source])


def _shuffled(n: int) -> NDArray[np.intp]:
    return np.random.default_rng(0).permutation(n)


def _backwards(root: Path) -> None:
    for path in root.rglob("image_02/data"):
        n = len(list(path.glob("*.png")))
        lines = [f"2011-09-26 13:02:{59 - i % 60:02d}.000000000" for i in range(n)]
        (path.parent / "timestamps.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _lidar_yaml(root: Path, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
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


def _mirror_events(root: Path) -> None:
    for path in root.rglob("rectify_map.h5"):
        with h5py.File(path, "r+") as file:
            rectified = file["rectify_map"][()]
            rectified[..., 0] = rectified.shape[1] - 1 - rectified[..., 0]
            file["rectify_map"][...] = rectified


def _offset(root: Path, microseconds: int) -> None:
    for path in root.rglob("events.h5"):
        with h5py.File(path, "r+") as file:
            file["t_offset"][()] = int(file["t_offset"][()]) + microseconds


def _first(root: Path, pattern: str) -> Iterator[Path]:
    """The first such file of every folder."""
    folders = {path.parent for path in root.rglob(pattern)}
    return (sorted(folder.glob(pattern))[0] for folder in sorted(folders))


def _cut(paths: Iterator[Path], share: float) -> None:
    for path in paths:
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content)) | 1 if share else 0])


def _remove(root: Path, name: str) -> None:
    for path in list(root.rglob(name)):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
