"""Synchronised images and scans of a ROS 1 bag, a ROS 2 bag or an MCAP file, one after the other.

with BagStream(Path("drive.mcap"), tolerance_s=0.05) as stream:
    for seen in stream:
        seen.image, seen.points, seen.K, seen.time
    stream.counts
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.bag_messages import image_of, lens_of, stamp_ns, transform_between
from uncal.recordings.plain_calibration import Lens
from uncal.recordings.point_cloud2 import brightest_of, read_points

SUFFIXES: tuple[str, ...] = (".bag", ".mcap", ".db3")

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CLOUDS = ("sensor_msgs/msg/PointCloud2",)
INFOS = ("sensor_msgs/msg/CameraInfo",)
_TRANSFORMS = "tf2_msgs/msg/TFMessage"

_WAITING = 32
"""Messages that wait for a partner; beyond that the oldest has none."""

_DAMAGE = (
    *(AnyReaderError, Reader1Error, Reader2Error, SerdeError, AssertionError, EOFError),
    *(LookupError, OSError, RuntimeError, ValueError, struct.error),
)


@dataclass(frozen=True)
class Observation:
    """An image and the scan nearest to it in time.

    Attributes:
        image: (H, W, 3) uint8 RGB, undistorted.
        points: (N, 4) float32 x, y, z in metres in the LiDAR frame, and reflectance in 0..1.
        K: (3, 3) camera matrix of the undistorted image, pixels.
        time: stamp of the scan, seconds.
        image_time: stamp of the image, seconds.
        n_dropped: points left out because they were not finite.
    """

    image: NDArray[np.uint8]
    points: NDArray[np.float32]
    K: NDArray[np.float64]
    time: float
    image_time: float
    n_dropped: int


@dataclass(frozen=True)
class Unpaired:
    """A message of a bag that becomes no :class:`Observation`.

    Attributes:
        time: its stamp, seconds.
        reason: for people.
    """

    time: float
    reason: str


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a .bag, .mcap or .db3 file, or a folder with metadata.yaml."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.is_file() and path.suffix in SUFFIXES


class BagStream(AbstractContextManager["BagStream"]):
    """Pairs the images and scans of a bag by their stamps while it is read; a context manager.

    Args:
        path: a bag.
        image: topic of Image or CompressedImage; None: the only one.
        points: topic of PointCloud2; None: the only one.
        camera_info: topic of CameraInfo; None: the image topic's neighbour, or the only one.
        tolerance_s: largest difference of the stamps of a pair, seconds.
        offset_s: added to the stamps of images before they are compared, seconds.

    Raises:
        RecordingError: the bag cannot be read, or lacks a kind of message.
        ConfigurationError: a topic is not there, or there are several to choose from.

    Attributes:
        lens: of the camera; its images are undistorted before they are handed out.
        T_cam_lidar: (4, 4) extrinsic of /tf_static between the frames that the messages name; None
            where the bag does not say.
        counts: ``images``, ``scans``, ``pairs``, ``undistorted``, and what had no partner or could
            not be read, so far.
        reasons: why messages could not be read → how many.
    """

    def __init__(
        self,
        path: Path,
        image: str | None = None,
        points: str | None = None,
        camera_info: str | None = None,
        tolerance_s: float = 0.05,
        offset_s: float = 0.0,
    ) -> None:
        if not is_bag(path):
            raise RecordingError(
                f"{path} is no bag: expected a .bag, .mcap or .db3 file, or the folder of a ROS 2 "
                "bag with its metadata.yaml."
            )
        if not tolerance_s > 0:
            raise ConfigurationError(f"tolerance={tolerance_s}: expected seconds above 0.")
        self.path = path
        self.counts: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self._tolerance_ns, self._offset_ns = round(1e9 * tolerance_s), round(1e9 * offset_s)
        self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        try:
            self._reader.open()
        except _DAMAGE as error:
            raise RecordingError(
                f"{path} cannot be opened as a bag ({error}); truncated? Copy it again."
            ) from error
        try:
            self._image = self._topic(image, IMAGES, "image")
            self._points = self._topic(points, CLOUDS, "points")
            self._info = self._topic(camera_info or self._neighbour(), INFOS, "camera_info")
            self.lens, camera_frame = self._camera()
            self.T_cam_lidar = self._extrinsic(camera_frame)
        except BaseException:
            self._reader.close()
            raise
        self._brightest: float | None = None

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._reader.close()

    def __iter__(self) -> Iterator[Observation]:
        """Pairs in the order of the scans.

        Raises:
            RecordingError: the file is damaged from here on.
        """
        return (seen for seen in self.everything() if isinstance(seen, Observation))

    def everything(self) -> Iterator[Observation | Unpaired]:
        """Pairs in the order of the scans, and what should have been one.

        Raises:
            RecordingError: the file is damaged from here on.
        """
        images: deque[tuple[int, bytes, str]] = deque()
        scans: deque[tuple[int, bytes, str]] = deque()
        for connection, stamp, raw in self._stamped():
            if connection is self._image:
                self.counts["images"] += 1
                images.append((stamp + self._offset_ns, raw, connection.msgtype))
            else:
                self.counts["scans"] += 1
                scans.append((stamp, raw, connection.msgtype))
            # A scan can be paired once an image later than it is there.
            while scans and (len(scans) > _WAITING or (images and images[-1][0] >= scans[0][0])):
                yield from self._paired(scans.popleft(), images)
            if len(images) > _WAITING and not scans:
                lonely = images.popleft()[0] - self._offset_ns
                yield Unpaired(lonely / 1e9, f"no LiDAR sweep among the last {_WAITING} images")
        while scans:
            yield from self._paired(scans.popleft(), images)

    def _paired(
        self, scan: tuple[int, bytes, str], images: deque[tuple[int, bytes, str]]
    ) -> Iterator[Observation | Unpaired]:
        nearest = min(images, key=lambda image: abs(image[0] - scan[0]), default=None)
        if nearest is None or abs(nearest[0] - scan[0]) > self._tolerance_ns:
            self.counts["scans without an image"] += 1
            tolerance = self._tolerance_ns / 1e9
            yield Unpaired(scan[0] / 1e9, f"no image within {tolerance:g} s of the LiDAR sweep")
            return
        while images and images[0][0] < nearest[0]:
            images.popleft()
        try:
            image = image_of(self._reader.deserialize(nearest[1], nearest[2]))
            if self.lens.size is not None and image.shape[:2] != self.lens.size:
                raise ValueError(
                    f"images have {image.shape[1]}×{image.shape[0]} pixels, CameraInfo says "
                    f"{self.lens.size[1]}×{self.lens.size[0]}"
                )
            cloud: Any = self._reader.deserialize(scan[1], scan[2])
            if self._brightest is None:
                self._brightest = brightest_of(cloud)
            points, n_dropped = read_points(cloud, self._brightest)
            if not len(points):
                raise ValueError("no finite point in the cloud")
        except _DAMAGE as error:
            self._note(error)
            yield Unpaired(scan[0] / 1e9, str(error))
            return
        self.counts["pairs"] += 1
        self.counts["undistorted"] += self.lens.model != "none"
        yield Observation(
            self.lens.undistort(image),
            points,
            self.lens.K_undistorted.copy(),
            scan[0] / 1e9,
            (nearest[0] - self._offset_ns) / 1e9,
            n_dropped,
        )

    def _note(self, error: Exception) -> None:
        self.counts["unreadable"] += 1
        self.reasons[str(error)] += 1

    def _stamped(self) -> Iterator[tuple[Connection, int, bytes]]:
        wanted = [self._image, self._points]
        try:
            for connection, _, raw in self._reader.messages(wanted):
                try:
                    stamp = stamp_ns(self._reader.deserialize(raw, connection.msgtype))
                except _DAMAGE as error:
                    self._note(error)
                    continue
                yield next(c for c in wanted if c.topic == connection.topic), stamp, raw
        except _DAMAGE as error:
            raise RecordingError(
                f"{self.path}: damaged after {self.counts['pairs']} pairs ({error})."
            ) from error

    def _topic(self, name: str | None, types: tuple[str, ...], setting: str) -> Connection:
        offered = [c for c in self._reader.connections if c.msgtype in types]
        chosen = [c for c in offered if name is None or c.topic == name]
        topics = ", ".join(sorted({c.topic for c in offered})) or "none"
        if len({c.topic for c in chosen}) == 1:
            return chosen[0]
        if not offered:
            raise RecordingError(f"{self.path} has no {' or '.join(types)}.")
        problem = "is not there" if name is not None else "must be chosen"
        raise ConfigurationError(f"{setting}={name} {problem}; {self.path} has {topics}.")

    def _neighbour(self) -> str | None:
        """The CameraInfo of the same camera, by ROS's habit of naming."""
        base = self._image.topic.removesuffix("/compressed").rsplit("/", 1)[0]
        beside = {c.topic for c in self._reader.connections if c.msgtype in INFOS}
        return f"{base}/camera_info" if f"{base}/camera_info" in beside else None

    def _first(self, connection: Connection) -> Any:  # noqa: ANN401
        for _, _, raw in self._reader.messages([connection]):
            return self._reader.deserialize(raw, connection.msgtype)
        raise RecordingError(f"{self.path}: no message on {connection.topic}.")

    def _camera(self) -> tuple[Lens, str]:
        try:
            info = self._first(self._info)
            return lens_of(info, "rect" in self._image.topic), str(info.header.frame_id)
        except _DAMAGE as error:
            raise RecordingError(f"{self.path}, {self._info.topic}: {error}.") from error

    def _extrinsic(self, camera_frame: str) -> NDArray[np.float64] | None:
        static = [
            c for c in self._reader.connections
            if c.msgtype == _TRANSFORMS and c.topic.endswith("tf_static")
        ]  # fmt: skip
        if not static:
            return None
        transforms: list[Any] = []
        for connection, _, raw in self._reader.messages(static):
            message: Any = self._reader.deserialize(raw, connection.msgtype)
            transforms += message.transforms
        lidar_frame = str(self._first(self._points).header.frame_id)
        return transform_between(transforms, camera_frame, lidar_frame)
