"""What every reader returns: one synchronised observation of a camera and a LiDAR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from uncal.events.stream import Events
from uncal.recordings.motion import KITTI_SPIN, Spin


@dataclass(frozen=True)
class FrameId:
    """Names one frame of a recording without loading it.

    Attributes:
        rig: the sensor setup; frames of one rig share one true extrinsic (KITTI: the date folder).
        drive: one continuous recording of that rig.
        index: the frame's number within its drive, as on disk.
    """

    rig: str
    drive: str
    index: int

    def __str__(self) -> str:
        """``rig/drive/0000000007``; unique within a recording and stable across machines."""
        return f"{self.rig}/{self.drive}/{self.index:010d}"


@dataclass(frozen=True)
class Frame:
    """One camera image, or window of events, and the LiDAR sweep taken with it.

    Attributes:
        id: where the frame comes from.
        image: (H, W, 3) uint8 RGB, rectified; grey cameras are repeated over the three channels.
            None for an event camera.
        points: (N, 4) float32 x, y, z in metres in the LiDAR frame, and reflectance in 0..1.
        K: (3, 3) float64 camera matrix of the rectified image or events, pixels.
        T_cam_lidar: (4, 4) float64 true extrinsic, LiDAR → this camera.
        time: seconds; NaN where the recording has no timestamps.
        n_dropped: points of the sweep left out because they were not finite.
        events: what an event camera saw before the sweep; None for an image.
        twist: (6,) velocity and turn rate of the LiDAR in its own frame, metres and radians per
            second, to undo the sweep's distortion; None where it is unknown or already undone.
        spin: when the sweep was measured, for the same purpose.
    """

    id: FrameId
    image: NDArray[np.uint8] | None
    points: NDArray[np.float32]
    K: NDArray[np.float64]
    T_cam_lidar: NDArray[np.float64]
    time: float
    n_dropped: int = 0
    events: Events | None = None
    twist: NDArray[np.float64] | None = None
    spin: Spin = KITTI_SPIN

    @property
    def drive(self) -> str:
        """The drive that the frame belongs to."""
        return self.id.drive

    @property
    def rig(self) -> str:
        """The rig that recorded the frame."""
        return self.id.rig


@runtime_checkable
class Recording(Protocol):
    """A folder of frames: what :mod:`uncal.data` needs from a reader.

    A new layout needs only these members.
    """

    @property
    def frame_ids(self) -> list[FrameId]:
        """Every frame that can be loaded as far as a look at the folder tells, in order."""
        ...

    @property
    def skipped(self) -> dict[str, str]:
        """Frames already known to be unusable: frame → reason."""
        ...

    def load(self, frame_id: FrameId) -> Frame:
        """Read one frame.

        Raises:
            FrameError: the frame is truncated or unreadable; the run skips, counts and reports it.
        """
        ...
