"""Progress: a bar on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TextIO, TypeVar, cast

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")

LOG_INTERVAL = 10.0
"""Seconds between lines where nobody watches."""

_LINE = "{desc}: {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"


def progress_bar(
    what: str,
    total: int,
    *,
    done: int = 0,
    unit: str = "step",
    leave: bool = True,
    quiet: bool = False,
) -> tqdm[Any]:
    """A bar to be advanced by hand."""
    kind, interval = _kind(sys.stderr)
    return kind(
        desc=what, total=total, initial=done, unit=unit, leave=leave, mininterval=interval,
        delay=_delay(kind), disable=quiet,
    )  # fmt: skip


def watched(items: Iterable[T], what: str, *, quiet: bool = False) -> Iterable[T]:
    """Go through something and show how far it is."""
    kind, interval = _kind(sys.stderr)
    bar: Iterable[T] = kind(
        items, desc=what, leave=False, mininterval=interval, delay=_delay(kind), disable=quiet
    )
    return bar


def _kind(stream: TextIO) -> tuple[type[tqdm[Any]], float]:
    return (tqdm, 0.5) if stream.isatty() else (LogLines, LOG_INTERVAL)


def _delay(kind: type[tqdm[Any]]) -> float:
    # What is over before a line is due needs none.
    return LOG_INTERVAL if kind is LogLines else 0.0


if TYPE_CHECKING:
    _Bar = tqdm[Any]
else:
    _Bar = tqdm


class LogLines(_Bar):
    """Lines in place of a bar that rewrites itself, for nohup, CI and batch systems."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        settings: dict[str, Any] = {"bar_format": _LINE, "dynamic_ncols": False, **kwargs}
        super().__init__(*cast("tuple[Any, ...]", args), **settings)

    @staticmethod
    def status_printer(file: Any) -> Callable[[str], None]:  # noqa: ANN401  # as tqdm has it
        """What tqdm shows itself with."""

        def show(text: str) -> None:
            if text.strip():
                file.write(f"{text.rstrip()}\n")
                file.flush()

        return show

    def moveto(self, n: int) -> None:
        """Stay: a log has no cursor."""

    def close(self) -> None:
        """Say how it ended, if it is to stay or took long enough to say anything before."""
        if self.disable:
            return
        self.disable = True
        cast(Any, self)._decr_instances(self)
        shown = self.last_print_t >= self.start_t + cast(float, cast(Any, self).delay)
        if self.n and (self.leave or shown):
            self.sp(str(self))
