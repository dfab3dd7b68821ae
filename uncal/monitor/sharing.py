"""What a frame's rounds, passes and residual have in common, computed once.

Features of the image are needed by the rounds, by the stochastic passes and by the residual, which
know nothing of each other. Within :func:`computed_once` each is computed for the first who asks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from uncal.models.alignment import AlignmentEstimator


class _Last:
    """A function that answers again what it answered last, if it is asked the same objects."""

    def __init__(self, function: Callable[..., object]) -> None:
        self.function = function
        self.asked: tuple[object, ...] | None = None
        self.answered: object = None

    def __call__(self, *args: object) -> object:
        if self.asked is None or not _same(self.asked, args):
            self.asked, self.answered = args, self.function(*args)
        return self.answered


def _same(before: tuple[object, ...], now: tuple[object, ...]) -> bool:
    return len(before) == len(now) and all(a is b for a, b in zip(before, now, strict=True))


@contextmanager
def computed_once(estimator: AlignmentEstimator) -> Iterator[None]:
    """Start, features of the image and what is read of them around edges, once for equal arguments.

    Answers are those that would have been computed again, so that nothing changes but the time.

    Args:
        estimator: whose methods are replaced meanwhile.
    """
    last = estimator.last
    parts = [(estimator, "begin"), (last.network, "describe"), (last.look, "forward")]
    before = [vars(owner).get(name) for owner, name in parts]
    for owner, name in parts:
        vars(owner)[name] = _Last(getattr(owner, name))
    try:
        yield
    finally:
        for (owner, name), own in zip(parts, before, strict=True):
            if own is None:
                del vars(owner)[name]
            else:
                vars(owner)[name] = own
