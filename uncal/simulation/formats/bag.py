"""A camera and a LiDAR as a ROS bag or MCAP file, for tests and to try out ``uncal.convert``.

    python -m uncal.simulation.formats.bag KITTI_ROOT DRIVE OUT

writes one drive of a KITTI raw folder, simulated or real, as an MCAP file in the folder OUT.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.errors import ConfigurationError
from uncal.recordings.kitti import KittiRaw
from uncal.settings.configuration import exits_on_error

_START = 1_700_000_000.0
"""Seconds since 1970 at which a bag begins."""


def write_bag(
    path: Path,  # of the bag; a folder for ROS 2
    images: list[tuple[float, NDArray[np.uint8]]],  # seconds and (H, W, 3) RGB
    scans: list[tuple[float, NDArray[np.float32]]],  # seconds and (N, 4), reflectance in 0..1
    K: NDArray[np.float64],  # (3, 3)
    T_cam_lidar: NDArray[np.float64] | None,  # (4, 4) for /tf_static
    kind: str = "mcap",  # or ros1, sqlite3
    lens: tuple[str, list[float]] = ("plumb_bob", [0.0] * 5),  # model and coefficients
    compressed: bool = False,  # JPEG
) -> Path:
    """Write /front/image_raw, /front/camera_info, /top/points and /tf_static."""
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:  # which rosbags leaves out
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    types: Any = store.types

    def header(seconds: float, frame: str) -> Any:  # noqa: ANN401
        ns = round(seconds * 1e9)
        time = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        more = {"seq": 0} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **more)

    messages: list[tuple[float, str, str, Any]] = []
    height, width = images[0][1].shape[:2]
    names = ("D", "K", "R", "P") if ros1 else ("d", "k", "r", "p")
    values = (
        np.array(lens[1]), K.ravel(), np.eye(3).ravel(),
        np.column_stack([K, np.zeros(3)]).ravel(),
    )  # fmt: skip
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = types["sensor_msgs/msg/CameraInfo"](
        header=header(images[0][0], "front_optical"), height=height, width=width,
        distortion_model=lens[0], binning_x=0, binning_y=0, roi=roi,
        **dict(zip(names, values, strict=True)),
    )  # fmt: skip
    messages.append((images[0][0], "/front/camera_info", "sensor_msgs/msg/CameraInfo", info))
    for seconds, image in images:
        if compressed:
            data = cv2.imencode(".jpg", image[..., ::-1])[1].ravel()
            kind_name, topic = "sensor_msgs/msg/CompressedImage", "/front/image_raw/compressed"
            message = types[kind_name](header(seconds, "front_optical"), "jpeg", data)
        else:
            kind_name, topic = "sensor_msgs/msg/Image", "/front/image_raw"
            message = types[kind_name](
                header(seconds, "front_optical"), height, width, "rgb8", 0, 3 * width,
                image.ravel(),
            )  # fmt: skip
        messages.append((seconds, topic, kind_name, message))
    field = types["sensor_msgs/msg/PointField"]
    fields = [field(name, 4 * i, 7, 1) for i, name in enumerate(("x", "y", "z", "intensity"))]
    for seconds, points in scans:
        bright = points * np.array([1, 1, 1, 255], np.float32)
        cloud = types["sensor_msgs/msg/PointCloud2"](
            header(seconds, "velodyne"), 1, len(points), fields, False, 16, 16 * len(points),
            np.frombuffer(bright.tobytes(), np.uint8), True,
        )  # fmt: skip
        messages.append((seconds, "/top/points", "sensor_msgs/msg/PointCloud2", cloud))
    if T_cam_lidar is not None:
        # camera → LiDAR as a tree has it: base → LiDAR, base → camera.
        T_base_lidar = np.eye(4)
        T_base_lidar[:3, 3] = [1.0, 0.0, 2.0]
        T_base_cam = T_base_lidar @ np.linalg.inv(T_cam_lidar)
        steps = []
        for child, T in (("velodyne", T_base_lidar), ("front_optical", T_base_cam)):
            q = Rotation.from_matrix(T[:3, :3]).as_quat()
            transform = types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist()),
                types["geometry_msgs/msg/Quaternion"](*q.tolist()),
            )
            stamped = types["geometry_msgs/msg/TransformStamped"]
            steps.append(stamped(header(images[0][0], "base_link"), child, transform))
        tf = types["tf2_msgs/msg/TFMessage"](steps)
        messages.append((images[0][0], "/tf_static", "tf2_msgs/msg/TFMessage", tf))
    messages.sort(key=lambda message: message[0])
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer: Any = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    serialize: Any = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for seconds, topic, name, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], round(seconds * 1e9), serialize(message, name))
    return path


def drive_as_bag(root: Path, drive: str, out: Path) -> Path:
    """Write a drive of a KITTI raw folder as an MCAP file.

    Args:
        root: of the recordings.
        drive: name or pattern.
        out: folder of the ROS 2 bag, which must not be there.

    Returns:
        The folder.

    Raises:
        UncalError: no drive, or several, or one that cannot be read.
    """
    recording = KittiRaw(root, drives=[drive])
    drives = sorted({f"{frame.rig}/{frame.drive}" for frame in recording.frame_ids})
    if len(drives) > 1:
        raise ConfigurationError(f"drive={drive}: matches {', '.join(drives)}; give one of them")
    frames = [recording.load(frame_id) for frame_id in recording.frame_ids]
    # ROS 2 counts seconds in 32 bits, which the simulation's dates, in 2041, do not fit into.
    times = [
        _START + (0.1 * i if np.isnan(frame.time) else frame.time - frames[0].time)
        for i, frame in enumerate(frames)
    ]
    images = [
        (t, frame.image) for t, frame in zip(times, frames, strict=True) if frame.image is not None
    ]
    scans = [(t, frame.points) for t, frame in zip(times, frames, strict=True)]
    return write_bag(out, images, scans, frames[0].K, frames[0].T_cam_lidar)


@exits_on_error
def main(arguments: Sequence[str] | None = None) -> None:
    """Write a drive as a bag; ``arguments`` are those of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m uncal.simulation.formats.bag",
        description="Writes a drive of a KITTI raw folder, simulated or real, as a ROS 2 bag.",
    )
    parser.add_argument("root", type=Path, help="folder of the recordings")
    parser.add_argument("drive", help="name or pattern of a drive")
    parser.add_argument("out", type=Path, help="folder of the bag, which must not be there")
    given = parser.parse_args(arguments)
    if given.out.exists():
        raise ConfigurationError(f"{given.out} exists; remove it, or give another name")
    sys.stdout.write(f"{drive_as_bag(given.root, given.drive, given.out)}\n")


if __name__ == "__main__":
    main()
