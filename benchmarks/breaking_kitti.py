"""Good KITTI raw folders, broken in each of the ways that a check should find."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from breaking import Faults, Matrix, geometric, of_files, undistort
from uncal.recordings.calibration_files import read_calibration_file
from uncal.recordings.kitti import KittiRaw

Image = NDArray[np.uint8]


def kitti_faults() -> Faults:
    """Name of a fault → its kind, and what puts it into a KITTI raw folder (camera image_02)."""
    return {
        **geometric(_velo, _points, _camera_frame, _K),
        "images (events) mirrored": (
            "mirrored",
            lambda root: _images(root, lambda image, _: image[:, ::-1]),
        ),
        "reflectances 0 to 255": ("reflectance", _in_bytes),
        "images resized, K kept": ("resolution", lambda root: _images(root, _smaller)),
        "distortion k1 = -0.3": ("distortion", lambda root: _images(root, _distorted)),
        "images (events) one frame late": (
            "clock",
            lambda root: _order(root, lambda n: np.arange(n) - 1),
        ),
        "images in another order": ("clock", lambda root: _order(root, _shuffled)),
        "clocks an hour apart": ("clock", lambda root: _stamps(root, lambda i: (14, i))),
        "time stamps run backwards": ("clock", lambda root: _stamps(root, lambda i: (13, -i))),
        **of_files("*.png", "image_02/data", "*.bin", "velodyne_points", "calib_velo_to_cam.txt"),
    }


def _velo(root: Path, change: Callable[[Matrix], Matrix]) -> None:
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


def _points(root: Path, matrix: Matrix, shift: Matrix | None = None) -> None:
    for path in root.rglob("velodyne_points/data/*.bin"):
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[:, :3] = points[:, :3] @ matrix.T + (0.0 if shift is None else shift)
        points.tofile(path)


def _in_bytes(root: Path) -> None:
    for path in root.rglob("velodyne_points/data/*.bin"):
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[:, 3] *= 255.0
        points.tofile(path)


def _camera_frame(root: Path) -> None:
    for date in (path.parent for path in root.rglob("calib_velo_to_cam.txt")):
        recording = KittiRaw(root, drives=[f"{date.name}/*"])
        T = recording.calibration(recording.frame_ids[0]).T_cam_lidar
        _points(date, T[:3, :3], T[:3, 3])


def _images(root: Path, change: Callable[[Image, float], Image]) -> None:
    for path in root.rglob("image_02/data/*.png"):
        image = np.asarray(cv2.imread(str(path)), np.uint8)
        known = read_calibration_file(path.parents[3] / "calib_cam_to_cam.txt")
        cv2.imwrite(str(path), np.ascontiguousarray(change(image, known["P_rect_02"][0, 0])))


def _smaller(image: Image, _: float) -> Image:
    small = cv2.resize(image, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def _distorted(image: Image, focal: float) -> Image:
    height, width = image.shape[:2]
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
    at = undistort(grid.astype(np.float64), K).reshape(height, width, 2).astype(np.float32)
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


def _stamps(root: Path, hour_and_tick: Callable[[int], tuple[int, int]]) -> None:
    """Stamps of scans 0.1 s apart from 13:02:30 on; of images as told, in ticks of 0.1 s."""
    for path in root.rglob("image_02/data"):
        drive, n = path.parents[1], len(list(path.glob("*.png")))
        for sensor, told in (("velodyne_points", lambda i: (13, i)), ("image_02", hour_and_tick)):
            ticks = [(hour, 300 + tick) for hour, tick in map(told, range(n))]
            lines = [f"2011-09-26 {hour}:02:{tick / 10:012.9f}" for hour, tick in ticks]
            (drive / sensor / "timestamps.txt").write_text(
                "\n".join(lines) + "\n", encoding="utf-8"
            )
