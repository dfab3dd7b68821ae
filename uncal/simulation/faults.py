"""What goes wrong on a vehicle beside the mounting, as transforms of a stream of frames.

>>> fault = FrozenLidar(first=20, last=30)
>>> list(fault([]))
[]
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from uncal.errors import ConfigurationError
from uncal.events.stream import Events
from uncal.recordings.frame import Frame
from uncal.settings import rules
from uncal.settings.group import SettingsGroup


@dataclass(frozen=True)
class Fault(SettingsGroup, ABC):
    """A fault of a stream; all other frames pass as they are.

    Attributes:
        first: first faulty frame, counted from 0 in the stream.
        last: last faulty frame.
    """

    first: int
    last: int

    def __post_init__(self) -> None:
        """Check the frames; no frame faulty is a :class:`ConfigurationError`."""
        super().__post_init__()
        if not 0 <= self.first <= self.last:
            raise ConfigurationError(
                f"{type(self).__name__}: first={self.first}, last={self.last}; expected "
                "0 <= first <= last"
            )

    @abstractmethod
    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream with the fault in it, as many frames with the same names and times."""

    def hits(self, number: int) -> bool:
        """Whether a frame of the stream is faulty."""
        return self.first <= number <= self.last


@dataclass(frozen=True)
class DroppedReturns(Fault):
    """The LiDAR loses returns at random: rain, dirt, a failing laser driver.

    Attributes:
        share: of the returns that are lost, in (0, 1].
        seed: of the losses.
    """

    key: ClassVar[str] = "DroppedReturns"
    share: Annotated[float, rules.number(0, 1, above=True)]
    seed: int = 0

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream with fewer points."""
        for number, frame in enumerate(frames):
            rng = np.random.default_rng((self.seed, number))
            kept = rng.random(len(frame.points)) >= self.share
            yield replace(frame, points=frame.points[kept]) if self.hits(number) else frame


@dataclass(frozen=True)
class BlackCamera(Fault):
    """The camera gives black images, or no events."""

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream without light."""
        for number, frame in enumerate(frames):
            image = None if frame.image is None else np.zeros_like(frame.image)
            dark = replace(frame, image=image, events=_silent(frame.events))
            yield dark if self.hits(number) else frame


@dataclass(frozen=True)
class FrozenLidar(Fault):
    """The driver repeats the last sweep before the fault, or the first of the stream."""

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream with one sweep repeated."""
        points = None
        for number, frame in enumerate(frames):
            if points is None or not self.hits(number):
                points = frame.points
            yield replace(frame, points=points)


@dataclass(frozen=True)
class SwappedFrames(Fault):
    """Two by two, frames come with each other's sweep: messages were paired wrongly.

    A last faulty frame without a partner stays as it is.
    """

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream with sweeps exchanged; reads one frame ahead."""
        waiting: Frame | None = None
        for number, frame in enumerate(frames):
            if waiting is not None:
                yield replace(waiting, points=frame.points)
                yield replace(frame, points=waiting.points)
                waiting = None
            elif self.hits(number) and self.hits(number + 1):
                waiting = frame
            else:
                yield frame
        if waiting is not None:
            yield waiting


@dataclass(frozen=True)
class ClockOffset(Fault):
    """The camera's clock is behind: every sweep meets an image taken before it.

    Attributes:
        frames: by how many frames, at least 1; at the beginning of the stream by as many as are
            there.
    """

    key: ClassVar[str] = "ClockOffset"
    frames: Annotated[int, rules.number(1, 1_000_000, whole=True)] = 1

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The stream with late images, or late events."""
        past: deque[Frame] = deque(maxlen=self.frames + 1)
        for number, frame in enumerate(frames):
            past.append(frame)
            late = replace(frame, image=past[0].image, events=past[0].events)
            yield late if self.hits(number) else frame


def _silent(events: Events | None) -> Events | None:
    if events is None:
        return None
    return replace(events, x=events.x[:0], y=events.y[:0], t=events.t[:0], p=events.p[:0])
