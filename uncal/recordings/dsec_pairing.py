"""Pairing the scans of a DSEC drive with the events of one of its sequences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.errors import FrameError, NothingPaired, RecordingError
from uncal.recordings.calibration_files import CameraCalibration
from uncal.recordings.dsec_events import EventFile
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.lidar_bag import LidarBag
from uncal.recordings.motion import KITTI_SPIN, Spin
from uncal.recordings.scan_motion import SweepMotion

SCAN_TIMES: tuple[str, ...] = ("end", "stamp")
"""What may count as the time of a scan: its last point, or the stamp of its message."""

DAY_US = 86_400_000_000
"""Microseconds of a day."""


def on_event_clock(
    time_ns: NDArray[np.int64],  # (n,) UNIX ns; rounded down: no event after the scan enters
    t_offset_us: int,  # the file's ``t_offset``
    first_us: int,  # the first event's, as in the file (without ``t_offset``)
) -> NDArray[np.int64]:
    """Times of scans on the clock that a sequence's events count on.

    That is microseconds since UTC midnight, of which day the events do not say; a sequence that
    runs past midnight goes on counting.
    ``first + ((time - t_offset - first) mod day)``: whatever day the events were recorded on, a
    scan taken during them comes out between their first and their last time. A scan taken before
    them comes out almost a day later.

    Returns:
        (n,) microseconds, in [first_us, first_us + one day), without ``t_offset``.

    >>> day, midnight = 19_000, 86_400
    >>> scan_ns = np.array([(day * midnight + 60) * 1_000_000_000 + 7_999])
    >>> on_event_clock(scan_ns, t_offset_us=59_000_000, first_us=0).tolist()
    [1000007]
    """
    return first_us + (time_ns // 1000 - t_offset_us - first_us) % DAY_US


def clock_time(time_us: int) -> str:
    """``HH:MM:SS`` in UTC, from microseconds since some UTC midnight, for a message.

    >>> clock_time(DAY_US + 3_661_000_000)
    '01:01:01'
    """
    seconds = time_us % DAY_US // 1_000_000
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


@dataclass(frozen=True)
class EventWindow:
    """The events that belong to a scan: those of a fixed time before it.

    Attributes:
        length_us: microseconds; the window ends at the scan's time, exclusive.
        min_events: a window with fewer is refused.
    """

    length_us: int
    min_events: int

    def too_few(self, found: str) -> str:
        """The reason for which a window is refused."""
        return (
            f"too few events: {found} in the {self.length_us / 1000:g} ms before the scan, "
            f"min_events is {self.min_events}"
        )


@dataclass(frozen=True)
class PairedSequence:
    """The scans taken between the first and the last event of one sequence, in order.

    Attributes:
        calibration: of the rectified event camera.
        events: its events.
        bag: the scans of the drive, of which the sequence is a part.
        positions: (n,) of the sequence's scans in the bag's index.
        times_ns: (n,) their UNIX times, nanoseconds.
        times_us: (n,) the same on the events' clock, microseconds without ``t_offset``.
        motion: tells how the LiDAR moves at each scan of the bag; None: sweeps are left as they
            are.
    """

    calibration: CameraCalibration
    events: EventFile
    bag: LidarBag
    positions: NDArray[np.intp]
    times_ns: NDArray[np.int64]
    times_us: NDArray[np.int64]
    motion: SweepMotion | None

    def __len__(self) -> int:
        """Number of scans."""
        return len(self.positions)

    def sort_out(self, window: EventWindow, stride: int) -> tuple[list[int], dict[int, str]]:
        """Which scans are frames, as far as ``ms_to_idx`` tells.

        Every ``stride``-th scan is kept, counted before any is left out.

        Returns:
            The numbers of the scans that are frames, and those with too few events → reason. Scans
            whose window would begin before the first event are in neither.

        Raises:
            RecordingError: no scan has a whole window, or the events cannot be read.
        """
        starts_us = self.times_us - window.length_us
        whole = [i for i in range(0, len(self), stride) if starts_us[i] >= self.events.first_us]
        if not whole:
            raise RecordingError(
                f"none of its {len(self)} scans (stride {stride}) has the whole window of "
                f"{window.length_us / 1000:g} ms after the first event; use a shorter window_ms"
            )
        counts = self.events.count_at_most(starts_us, self.times_us)
        poor = {
            i: window.too_few(f"at most {counts[i]}")
            for i in whole
            if counts[i] < window.min_events
        }
        return [i for i in whole if i not in poor], poor

    def load(self, frame_id: FrameId, window: EventWindow) -> Frame:
        """Read one frame, whose ``index`` counts the scans of this sequence.

        Raises:
            FrameError: the scan or the events cannot be read, or there are too few events.
        """
        end_us = int(self.times_us[frame_id.index])
        events = self.events.read(end_us - window.length_us, end_us)
        if len(events) < window.min_events:
            raise FrameError(f"{self.events.path}: {window.too_few(str(len(events)))}.")
        position = int(self.positions[frame_id.index])
        points, n_dropped = self.bag.read(position)
        twist = None if self.motion is None else self.motion.twist(position)
        return Frame(
            id=frame_id,
            image=None,
            points=points,
            K=self.calibration.K.copy(),
            T_cam_lidar=self.calibration.T_cam_lidar.copy(),
            time=float(self.times_ns[frame_id.index]) / 1e9,
            n_dropped=n_dropped,
            events=events,
            twist=twist,
            spin=KITTI_SPIN if twist is None else self._spin(frame_id.index),
        )

    def _spin(self, index: int) -> Spin:
        position = int(self.positions[index])
        spin = self.bag.spin(position)
        if spin is None:
            return KITTI_SPIN
        stamp_ns = int(self.bag.index.stamp_ns[position])
        return spin._replace(ahead_s=spin.ahead_s + (stamp_ns - int(self.times_ns[index])) / 1e9)


def pair(
    events: EventFile,
    bag: LidarBag,
    calibration: CameraCalibration,
    scan_time: str,
    motion: SweepMotion | None = None,
) -> PairedSequence:
    """Find the scans of a drive that were taken during a sequence; see :class:`PairedSequence`.

    ``scan_time`` is one of :data:`SCAN_TIMES`.

    Raises:
        RecordingError: there is no such scan.
    """
    index = bag.index
    times_ns = index.end_ns if scan_time == "end" else index.stamp_ns
    times_us = on_event_clock(times_ns, events.t_offset, events.first_us)
    (positions,) = np.nonzero(times_us <= events.end_us)
    if not len(positions):
        first, last = (events.t_offset + time for time in (events.first_us, events.end_us))
        raise NothingPaired(
            f"no scan of {bag.path} is from the time of its events, {clock_time(first)} to "
            f"{clock_time(last)} UTC; the scans are from {clock_time(int(times_ns[0]) // 1000)} "
            f"to {clock_time(int(times_ns[-1]) // 1000)}"
        )
    return PairedSequence(
        calibration, events, bag, positions, times_ns[positions], times_us[positions], motion
    )
