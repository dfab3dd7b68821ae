"""``rig.yaml`` of the plain folder: cameras, LiDARs and what leads from one to the other."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import (
    check_rotation,
    height_width,
    is_camera_matrix,
    numbers,
    read_calibration_yaml,
)

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Unit of lengths → metres."""

COEFFICIENTS: dict[str, tuple[int, ...]] = {"none": (0,), "radtan": (4, 5, 8), "fisheye": (4,)}
"""Lens → number of coefficients, OpenCV's order: k1, k2, p1, p2, k3, …, or k1 to k4."""


@dataclass(frozen=True)
class Lens:
    """A camera as its file describes it, and the undistorted one that it is turned into.

    Attributes:
        K: (3, 3) camera matrix of the images as recorded, pixels.
        size: (H, W) of those images; None where the file does not say.
        model: a key of :data:`COEFFICIENTS`.
        coefficients: of the distortion.
    """

    K: NDArray[np.float64]
    size: tuple[int, int] | None
    model: str = "none"
    coefficients: tuple[float, ...] = ()

    @cached_property
    def K_undistorted(self) -> NDArray[np.float64]:
        """(3, 3) camera matrix after :meth:`undistort`: all of its pixels come from the image."""
        if self.model == "none":
            return self.K
        assert self.size is not None
        size, lens = self.size[::-1], np.array(self.coefficients)
        if self.model == "fisheye":
            new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
                self.K, lens, size, np.eye(3), balance=0.0
            )
        else:
            new, _ = cv2.getOptimalNewCameraMatrix(self.K, lens, size, 0.0)
        return np.asarray(new, dtype=np.float64)

    def undistort(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """An (H, W, 3) image as a lens without distortion would show it."""
        if self.model == "none":
            return image
        column, row = self._maps
        return np.asarray(cv2.remap(image, column, row, cv2.INTER_LINEAR), dtype=np.uint8)

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        assert self.size is not None
        of_model = cv2.fisheye if self.model == "fisheye" else cv2
        return of_model.initUndistortRectifyMap(  # type: ignore[no-any-return]
            self.K, np.array(self.coefficients), np.eye(3), self.K_undistorted,
            self.size[::-1], cv2.CV_32FC1,
        )  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """What ``rig.yaml`` says.

    Attributes:
        name: of the rig.
        cameras: name → lens.
        lidars: name → metres by the unit of its files, and the brightness that stands for 1.
        T_cam_lidar: camera, LiDAR → (4, 4), metres.
        tolerance_s: images and scans are paired by time, at most so far apart; None: by name.
    """

    name: str
    cameras: dict[str, Lens]
    lidars: dict[str, tuple[float, float]]
    T_cam_lidar: dict[tuple[str, str], NDArray[np.float64]]
    tolerance_s: float | None


def read_rig(path: Path) -> Rig:
    """Read ``rig.yaml``, which docs/own-rig.md describes.

    Raises:
        CalibrationMissing: it is not there.
        RotationError: a rotation is none.
        RecordingError: a key is missing or wrong.
    """
    content = read_calibration_yaml(path, "docs/own-rig.md says what belongs into it.")
    needed, allowed = {"cameras", "lidars", "extrinsics"}, {"name", "pairing"}
    content = _mapping(content, path, "the file", needed, allowed)
    cameras = {
        str(name): _lens(value, path, f"cameras.{name}")
        for name, value in _mapping(content["cameras"], path, "cameras").items()
    }
    lidars = {}
    for name, value in _mapping(content["lidars"], path, "lidars").items():
        of = _mapping(value or {}, path, f"lidars.{name}", set(), {"units", "brightest"})
        brightest = float(str(of.get("brightest", 1.0)))
        lidars[str(name)] = (_unit(of, path, f"lidars.{name}"), brightest)
    extrinsics = {}
    for camera, targets in _mapping(content["extrinsics"], path, "extrinsics").items():
        for lidar, value in _mapping(targets, path, f"extrinsics.{camera}").items():
            where = f"extrinsics.{camera}.{lidar}"
            if camera not in cameras or lidar not in lidars:
                raise RecordingError(f"{path}: {where} names no camera and LiDAR of the file.")
            extrinsics[str(camera), str(lidar)] = parse_transform(value, path, where)
    pairing = _mapping(content.get("pairing") or {}, path, "pairing", set(), {"tolerance_s"})
    tolerance = pairing.get("tolerance_s")
    name = str(content.get("name", path.parent.resolve().name))
    return Rig(
        name, cameras, lidars, extrinsics, None if tolerance is None else float(str(tolerance))
    )


def _lens(value: object, path: Path, where: str) -> Lens:
    of = _mapping(value, path, where, {"K"}, {"size", "distortion"})
    K = numbers(of["K"], None, path, f"{where}.K")
    if K.shape == (4,):
        K = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1.0]])
    if not is_camera_matrix(K):
        raise RecordingError(
            f"{path}: {where}.K is {of['K']}, expected [fx, fy, cx, cy] or 3×3, in pixels."
        )
    size = None
    if of.get("size") is not None:
        size = height_width(numbers(of["size"], (2,), path, f"{where}.size"))
    given = of.get("distortion") or {"model": "none"}
    lens = _mapping(given, path, f"{where}.distortion", {"model"}, {"coefficients"})
    model = str(lens["model"])
    found = numbers(lens.get("coefficients") or [], None, path, f"{where}.distortion.coefficients")
    if model not in COEFFICIENTS or found.size not in COEFFICIENTS[model]:
        raise RecordingError(
            f"{path}: {where}.distortion is {dict(lens)}, expected model none, radtan (4, 5 or 8 "
            "coefficients) or fisheye (4)."
        )
    if model != "none" and size is None:
        raise RecordingError(f"{path}: {where}.size is missing: [width, height] of the images.")
    return Lens(K, size, model, tuple(found.ravel().tolist()))


def parse_transform(value: object, path: Path, where: str) -> NDArray[np.float64]:
    """(4, 4) in metres from a 4×4 matrix, or from a translation and one of several rotations.

    Raises:
        RecordingError: it is neither.
        RotationError: its rotation is none.
    """
    if not isinstance(value, Mapping):
        T = numbers(value, (4, 4), path, where)
    else:
        rotations = {"rotation", "rotation_deg", "rotation_rad", "quaternion_xyzw"}
        of = _mapping(value, path, where, {"translation"}, rotations | {"units"})
        given = rotations & set(of)
        if len(given) != 1:
            raise RecordingError(f"{path}: {where} needs one of {', '.join(sorted(rotations))}.")
        key = given.pop()
        shape = {"rotation": (3, 3), "quaternion_xyzw": (4,)}.get(key, (3,))
        found = numbers(of[key], shape, path, f"{where}.{key}")
        T = np.eye(4)
        if key == "rotation":
            T[:3, :3] = found
        elif key == "quaternion_xyzw":
            T[:3, :3] = Rotation.from_quat(found).as_matrix()
        else:
            T[:3, :3] = Rotation.from_euler("xyz", found, key == "rotation_deg").as_matrix()
        shift = numbers(of["translation"], (3,), path, f"{where}.translation")
        T[:3, 3] = shift * _unit(of, path, where)
    check_rotation(T[:3, :3], where, path, "Write it row by row, with all its digits.")
    return T


def _unit(of: Mapping[str, object], path: Path, where: str) -> float:
    unit = str(of.get("units", "m"))
    if unit not in UNITS:
        raise RecordingError(f"{path}: {where}.units is {unit}, expected {', '.join(UNITS)}.")
    return UNITS[unit]


def _mapping(
    value: object,
    path: Path,
    where: str,
    needed: Set[str] | None = None,  # None: keys are names, which are not checked
    allowed: Set[str] = frozenset(),
) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise RecordingError(f"{path}: {where} is {value}, expected keys with values.")
    if needed is not None and (missing := needed - set(value)):
        raise RecordingError(f"{path}: {where} lacks {', '.join(sorted(missing))}.")
    if needed is not None and (unknown := set(value) - needed - allowed):
        raise RecordingError(
            f"{path}: {where} has the unknown {', '.join(sorted(map(str, unknown)))}; known are "
            f"{', '.join(sorted(needed | allowed))}."
        )
    return value
