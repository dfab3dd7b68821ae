"""Writes the frames of a bag as a plain folder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.bag_stream import BagStream
from uncal.recordings.plain_calibration import FILE, parse_transform, read_rig
from uncal.recordings.plain_folder import STAMPS
from uncal.system.progress import watched

_KNOWN = 1e-6
"""Difference of calibrations that rounding explains."""


def read_extrinsic(path: str | Path) -> NDArray[np.float64]:
    """``T_cam_lidar`` of a YAML file.

    Args:
        path: of the file; 4×4, or in any form of ``extrinsics`` in ``rig.yaml``.

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
    """Write one drive, and ``rig.yaml`` if it is the first.

    Args:
        stream: of the bag.
        root: the plain folder.
        drive: name of the drive's folder, which must not be there.
        camera: name of the camera in ``rig.yaml``.
        lidar: name of the LiDAR.
        T_cam_lidar: (4, 4) extrinsic, metres.
        every: keep every n-th pair.
        progress: show it.

    Returns:
        The drive's folder.

    Raises:
        ConfigurationError: there is no extrinsic, the drive exists, or the folder is of another
            rig.
        RecordingError: the bag gives not one pair, or is damaged; what was written stays.
    """
    if T_cam_lidar is None:
        raise ConfigurationError(
            f"{stream.path} has no transform between camera and LiDAR in /tf_static: give "
            "extrinsic=FILE, a YAML file with T_cam_lidar (4×4, LiDAR → camera, metres)."
        )
    folder = root / drive
    if folder.exists():
        raise ConfigurationError(f"{folder} exists; remove it, or give drive=another_name.")
    _write_rig(root, stream, camera, lidar, T_cam_lidar)
    images, scans = folder / camera, folder / lidar
    images.mkdir(parents=True)
    scans.mkdir()
    times: list[tuple[float, float]] = []
    pairs = watched(stream, "converting", quiet=not progress)
    for number, seen in enumerate(pairs):
        if number % every:
            continue
        name = f"{len(times):06d}"
        cv2.imwrite(str(images / f"{name}.png"), seen.image[..., ::-1])
        seen.points.tofile(scans / f"{name}.bin")
        times.append((seen.image_time, seen.time))
    for sensor, column in ((images, 0), (scans, 1)):
        lines = "".join(f"{pair[column]:.9f}\n" for pair in times)
        (sensor / STAMPS).write_text(lines, encoding="utf-8")
    if not times:
        folders = ", ".join(f"{what}: {n}" for what, n in stream.counts.items())
        reason = next(iter(stream.reasons), "")
        raise RecordingError(
            f"{stream.path}: not one pair ({folders or 'no messages'}). {reason or 'Their stamps'} "
            + ("" if reason else "differ too much: look at tolerance_s and offset_s.")
        )
    return folder


def _write_rig(
    root: Path, stream: BagStream, camera: str, lidar: str, T: NDArray[np.float64]
) -> None:
    K, size = stream.lens.K_undistorted, stream.lens.size
    path = root / FILE
    if path.is_file():
        rig = read_rig(path)
        known = rig.T_cam_lidar.get((camera, lidar))
        same = known is not None and np.abs(known - T).max() < _KNOWN
        if not same or np.abs(rig.cameras[camera].K - K).max() > _KNOWN * K[0, 0]:
            raise ConfigurationError(
                f"{path} is of another rig (other camera matrix, extrinsic or names); give another "
                "root."
            )
        return
    assert size is not None
    content = {
        "name": root.resolve().name,
        "cameras": {camera: {"K": K.tolist(), "size": [size[1], size[0]]}},
        "lidars": {lidar: {"units": "m"}},
        "extrinsics": {camera: {lidar: T.tolist()}},
    }
    root.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
