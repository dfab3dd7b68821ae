from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from uncal.errors import ConfigurationError
from uncal.events.stream import Events
from uncal.recordings.frame import Frame, FrameId
from uncal.simulation.faults import (
    BlackCamera,
    ClockOffset,
    DroppedReturns,
    Fault,
    FrozenLidar,
    SwappedFrames,
)

N = 8
BEFORE_AND_AFTER = (0, 1, 2, 6, 7)


def stream() -> list[Frame]:
    """Frames whose every image and sweep carry the frame's number."""
    return [
        Frame(
            id=FrameId("rig", "drive", number + 100),
            image=np.full((4, 6, 3), 10 + number, np.uint8),
            points=np.full((1000, 4), number, np.float32),
            K=np.eye(3),
            T_cam_lidar=np.eye(4),
            time=0.4 * number,
        )
        for number in range(N)
    ]


def images(frames: list[Frame]) -> list[int]:
    return [int(frame.image[0, 0, 0]) - 10 for frame in frames if frame.image is not None]


def sweeps(frames: list[Frame]) -> list[int]:
    return [int(frame.points[0, 0]) for frame in frames]


@pytest.mark.parametrize(
    "fault",
    [
        DroppedReturns(3, 5, share=0.5),
        BlackCamera(3, 5),
        FrozenLidar(3, 5),
        SwappedFrames(3, 5),
        ClockOffset(3, 5),
    ],
)
def test_only_the_frames_of_the_fault_change(fault: Fault) -> None:
    given = stream()
    found = list(fault(iter(given)))
    assert [frame.id for frame in found] == [frame.id for frame in given]
    assert [frame.time for frame in found] == [frame.time for frame in given]
    for number in BEFORE_AND_AFTER:
        assert found[number].image is given[number].image
        assert found[number].points is given[number].points
    changed = [
        number
        for number in range(3, 6)
        if found[number].image is not given[number].image
        or found[number].points is not given[number].points
    ]
    # The third of three frames has no partner to be swapped with.
    assert changed == ([3, 4] if isinstance(fault, SwappedFrames) else [3, 4, 5])


def test_returns_are_lost_at_the_rate_asked_for() -> None:
    found = list(DroppedReturns(3, 5, share=0.9, seed=1)(stream()))
    left = [len(frame.points) for frame in found]
    assert all(left[number] == 1000 for number in BEFORE_AND_AFTER)
    # Within five standard deviations of the binomial law.
    assert all(100 - 48 < number < 100 + 48 for number in left[3:6])
    assert len(set(left[3:6])) > 1
    again = list(DroppedReturns(3, 5, share=0.9, seed=1)(stream()))
    assert [len(frame.points) for frame in again] == left
    assert len(next(iter(DroppedReturns(0, 0, share=1.0)(stream()))).points) == 0


def test_camera_is_black() -> None:
    found = list(BlackCamera(3, 5)(stream()))
    assert images(found) == [0, 1, 2, -10, -10, -10, 6, 7]
    assert sweeps(found) == list(range(N))


def test_an_event_camera_falls_silent() -> None:
    nothing = np.zeros(0, np.float32)
    some = Events(nothing + 1, nothing, np.arange(5), nothing > 0, (0, 9), (4, 6))
    frames = [replace(frame, image=None, events=some) for frame in stream()]
    found = list(BlackCamera(3, 5)(frames))
    assert [len(frame.events or []) for frame in found] == [5, 5, 5, 0, 0, 0, 5, 5]
    assert found[3].events is not None
    assert found[3].events.size == (4, 6)


def test_lidar_freezes_at_the_sweep_before() -> None:
    assert sweeps(list(FrozenLidar(3, 5)(stream()))) == [0, 1, 2, 2, 2, 2, 6, 7]
    assert sweeps(list(FrozenLidar(0, 2)(stream()))) == [0, 0, 0, 3, 4, 5, 6, 7]


def test_sweeps_are_swapped_two_by_two() -> None:
    found = list(SwappedFrames(2, 5)(stream()))
    assert sweeps(found) == [0, 1, 3, 2, 5, 4, 6, 7]
    assert images(found) == list(range(N))
    # Beyond the end of the drive there is nothing to swap with.
    assert sweeps(list(SwappedFrames(7, 9)(stream()))) == list(range(N))


def test_clock_offset_pairs_a_sweep_with_an_earlier_image() -> None:
    found = list(ClockOffset(3, 5, frames=2)(stream()))
    assert images(found) == [0, 1, 2, 1, 2, 3, 6, 7]
    assert sweeps(found) == list(range(N))
    assert images(list(ClockOffset(0, 3, frames=2)(stream())))[:4] == [0, 0, 0, 1]


def test_a_stream_is_read_as_it_comes() -> None:
    """A monitor on a vehicle cannot wait for the end of the drive."""
    read: list[int] = []

    def coming() -> Iterator[Frame]:
        for number, frame in enumerate(stream()):
            read.append(number)
            yield frame

    for fault, ahead in ((FrozenLidar(3, 5), 0), (ClockOffset(3, 5), 0), (SwappedFrames(3, 5), 1)):
        read.clear()
        for number, _ in enumerate(fault(coming())):
            assert len(read) - 1 <= number + ahead


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BlackCamera(5, 4), r"BlackCamera: first=5, last=4; expected 0 <= first <= last"),
        (lambda: FrozenLidar(-1, 4), r"FrozenLidar: first=-1"),
        (
            lambda: DroppedReturns(0, 1, share=1.5),
            r"DroppedReturns\.share=1\.5: expected a number above 0 and up to 1",
        ),
        (
            lambda: ClockOffset(0, 1, frames=0),
            r"ClockOffset.frames=0: expected a whole number from 1",
        ),
    ],
)
def test_settings_out_of_range_are_refused(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(ConfigurationError, match=message):
        make()
