"""The first minute of a bag as a recording, so that it can be checked before it is converted."""

from __future__ import annotations

from pathlib import Path

from uncal.errors import CalibrationMissing, NothingPaired
from uncal.recordings.bag_stream import BagStream
from uncal.recordings.frame import Frame, FrameId

FIRST, SECOND, RUN = 0, 60, 4
"""Two stretches of so many pairs are kept, from these numbers on."""


class BagRecording:
    """Some frames of a bag, in memory; implements :class:`~uncal.recordings.frame.Recording`.

    Args:
        path: of the bag.
        image: topic of the images; None: the only one.

    Raises:
        RecordingError: the bag cannot be read, has no extrinsic or no pair.
        ConfigurationError: the topic is not there, or there are several.

    Attributes:
        frame_ids: the frames that are kept.
        skipped: none; what has no partner in a bag is usual where one sensor is faster.
    """

    def __init__(self, path: Path, image: str | None = None) -> None:
        self._frames: dict[FrameId, Frame] = {}
        self.skipped: dict[str, str] = {}
        name = path.name.removesuffix(path.suffix)
        with BagStream(path, image) as stream:
            if stream.T_cam_lidar is None:
                raise CalibrationMissing(
                    f"{path}: /tf_static does not lead from the LiDAR to the camera; convert it "
                    "with extrinsic=FILE and check the folder."
                )
            for number, seen in enumerate(stream):
                if FIRST <= number < FIRST + RUN or SECOND <= number < SECOND + RUN:
                    frame_id = FrameId(name, name, number)
                    self._frames[frame_id] = Frame(
                        frame_id, seen.image, seen.points, seen.K, stream.T_cam_lidar, seen.time
                    )
                if number >= SECOND + RUN:
                    break
            counts = ", ".join(f"{what}: {n}" for what, n in stream.counts.items())
        if not self._frames:
            raise NothingPaired(f"{path}: not one image and scan within 50 ms ({counts}).")

    @property
    def frame_ids(self) -> list[FrameId]:
        """The frames that are kept, in order of time."""
        return list(self._frames)

    def load(self, frame_id: FrameId) -> Frame:
        """One of them."""
        return self._frames[frame_id]
