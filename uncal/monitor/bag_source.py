"""Frames of a ROS 1 bag, a ROS 2 bag or an MCAP file, read as they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.recordings.bag_conversion import read_extrinsic
from uncal.recordings.bag_stream import BagStream, Observation, Unpaired
from uncal.recordings.frame import Frame, FrameId


@dataclass(frozen=True, kw_only=True)
class BagSettings:
    """What of a bag is watched.

    Attributes:
        camera_topic: of Image or CompressedImage; None: the only one.
        lidar_topic: of PointCloud2; None: the only one.
        info_topic: of CameraInfo; None: the image topic's neighbour, or the only one.
        extrinsic: YAML file with the nominal ``T_cam_lidar``; None: /tf_static of the bag.
        tolerance_s: largest difference between the stamps of an image and a sweep, seconds.
        offset_s: added to the stamps of images before they are compared, seconds.
    """

    camera_topic: str | None = None
    lidar_topic: str | None = None
    info_topic: str | None = None
    extrinsic: Path | None = None
    tolerance_s: float = 0.05
    offset_s: float = 0.0


def bag_frames(path: Path, settings: BagSettings) -> Iterator[Frame | tuple[FrameId, str]]:
    """Synchronised frames in the order of the sweeps; what has no partner comes with the reason.

    Rig and drive have the name of the bag; numbers count all that comes. Sweeps are taken as they
    are: a bag says nothing of the vehicle's motion within them.

    Args:
        path: of the bag.
        settings: topics and nominal extrinsic.

    Raises:
        RecordingError: the bag cannot be read, or is damaged from here on.
        ConfigurationError: a topic is not there, or there is no nominal extrinsic.
    """
    name = path.name.removesuffix(path.suffix)
    with BagStream(
        path,
        settings.camera_topic,
        settings.lidar_topic,
        settings.info_topic,
        settings.tolerance_s,
        settings.offset_s,
    ) as stream:
        T_cam_lidar = _nominal(stream, settings.extrinsic)
        for number, seen in enumerate(stream.everything()):
            frame_id = FrameId(name, name, number)
            if isinstance(seen, Unpaired):
                yield frame_id, seen.reason
            else:
                yield _frame(frame_id, seen, T_cam_lidar)


def _frame(frame_id: FrameId, seen: Observation, T_cam_lidar: NDArray[np.float64]) -> Frame:
    return Frame(
        frame_id, seen.image, seen.points, seen.K, T_cam_lidar.copy(), seen.time, seen.n_dropped
    )


def _nominal(stream: BagStream, file: Path | None) -> NDArray[np.float64]:
    T_cam_lidar = stream.T_cam_lidar if file is None else read_extrinsic(file)
    if T_cam_lidar is None:
        raise ConfigurationError(
            f"{stream.path} has no transform between camera and LiDAR in /tf_static: give "
            "extrinsic=FILE, a YAML file with the nominal T_cam_lidar (4×4, LiDAR → camera, metres)"
        )
    return T_cam_lidar
