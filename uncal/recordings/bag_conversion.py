"""Writes the frames of a bag as a plain folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.bag_stream import BagStream, Observation
from uncal.recordings.folder_listing import RIG_FILE
from uncal.recordings.plain_calibration import parse_transform, read_rig
from uncal.recordings.plain_folder import STAMPS
from uncal.recordings.sensor_files import write_image
from uncal.system.progress import watched

_KNOWN = 1e-6
"""Difference of calibrations that rounding explains."""


def read_extrinsic(path: str | Path) -> NDArray[np.float64]:
    """``T_cam_lidar`` of a YAML file: 4×4, or any form of ``extrinsics`` in ``rig.yaml``.

    Raises:
        RecordingError: it cannot be read, or what it holds is no transform.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise RecordingError(f"extrinsic={path} cannot be read ({error}).") from error
    if not isinstance(content, dict) or "T_cam_lidar" not in content:
        raise RecordingError(f"extrinsic={path}: expected the key T_cam_lidar with a 4×4 matrix.")
    return parse_transform(content["T_cam_lidar"], path, "T_cam_lidar")


def write_folder(
    stream: BagStream,
    root: Path,
    drive: str,
    camera: str,
    lidar: str,
    T_cam_lidar: NDArray[np.float64] | None,
    every: int = 1,
    progress: bool = True,
) -> Path:
    """Write one drive, and ``rig.yaml`` if it is the first; returns the drive's folder.

    Args:
        stream: of the bag.
        root: the plain folder.
        drive: name of the drive's folder, which must not be there.
        camera: name of the camera in ``rig.yaml``.
        lidar: name of the LiDAR.
        T_cam_lidar: (4, 4) extrinsic, metres.
        every: keep every n-th pair.
        progress: show it.

    Raises:
        ConfigurationError: there is no extrinsic, the drive exists, a name is none of a folder, or
            the root is of another rig.
        RecordingError: the bag gives not one pair, or is damaged; the pairs before that are kept.
    """
    if T_cam_lidar is None:
        raise ConfigurationError(
            f"{stream.path} has no transform between camera and LiDAR in /tf_static: give "
            "extrinsic=FILE, a YAML file with T_cam_lidar (4×4, LiDAR → camera, metres)."
        )
    for key, name in (("drive", drive), ("camera", camera), ("lidar", lidar)):
        if not name or Path(name).name != name or name.startswith("."):
            raise ConfigurationError(f"{key}={name}: expected the name of a folder, without a path")
    if camera == lidar:
        raise ConfigurationError(
            f"camera={camera}, lidar={lidar}: each needs a folder, and so a name, of its own"
        )
    folder, partial = root / drive, root / f".{drive}.partial"
    if folder.exists():
        raise ConfigurationError(f"{folder} exists; remove it, or give drive=another_name.")
    rig = _new_rig(root, stream, camera, lidar, T_cam_lidar)
    if partial.exists():  # of a conversion that was killed
        shutil.rmtree(partial)
    pairs = watched(stream, "converting", quiet=not progress)
    try:
        n, damage = _write_pairs(pairs, partial / camera, partial / lidar, every)
        if n:
            if rig is not None:
                (partial / RIG_FILE).write_text(rig, encoding="utf-8")
                (partial / RIG_FILE).replace(root / RIG_FILE)
            partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    if n and damage is not None:
        raise RecordingError(f"{damage} The {n} frames before that are in {folder}.") from damage
    if damage is not None:
        raise damage
    if not n:
        counts = ", ".join(f"{what}: {m}" for what, m in stream.counts.items())
        reason = next(iter(stream.reasons), "")
        raise RecordingError(
            f"{stream.path}: not one pair ({counts or 'no messages'}). {reason or 'Their stamps'} "
            + ("" if reason else "differ too much: look at tolerance_s and offset_s.")
        )
    return folder


def _write_pairs(
    pairs: Iterable[Observation], images: Path, scans: Path, every: int
) -> tuple[int, RecordingError | None]:
    """Write files and time stamps; gives how many, and what ended the bag before its end."""
    images.mkdir(parents=True)
    scans.mkdir()
    times: list[tuple[float, float]] = []
    damage = None
    try:
        for number, seen in enumerate(pairs):
            if number % every:
                continue
            name = f"{len(times):06d}"
            write_image(images / f"{name}.png", seen.image)
            (scans / f"{name}.bin").write_bytes(seen.points.tobytes())
            times.append((seen.image_time, seen.time))
    except RecordingError as error:
        damage = error
    for sensor, column in ((images, 0), (scans, 1)):
        lines = "".join(f"{pair[column]:.9f}\n" for pair in times)
        (sensor / STAMPS).write_text(lines, encoding="utf-8")
    return len(times), damage


def _new_rig(
    root: Path, stream: BagStream, camera: str, lidar: str, T: NDArray[np.float64]
) -> str | None:
    """Text of the ``rig.yaml`` that the root lacks; None if it has the same already."""
    K, size = stream.lens.K_undistorted, stream.lens.size
    path = root / RIG_FILE
    if path.is_file():
        rig = read_rig(path)
        known = rig.T_cam_lidar.get((camera, lidar))
        same = known is not None and np.abs(known - T).max() < _KNOWN
        if not same or np.abs(rig.cameras[camera].K - K).max() > _KNOWN * K[0, 0]:
            raise ConfigurationError(
                f"{path} is of another rig (other camera matrix, extrinsic or names); give another "
                "root."
            )
        return None
    assert size is not None
    content = {
        "name": root.resolve().name,
        "cameras": {camera: {"K": K.tolist(), "size": [size[1], size[0]]}},
        "lidars": {lidar: {"units": "m"}},
        "extrinsics": {camera: {lidar: T.tolist()}},
    }
    text: str = yaml.safe_dump(content, sort_keys=False)
    return text
