"""The live view for people: a table on a terminal, a line every few seconds in a log."""

from __future__ import annotations

import logging
import math
import sys
import time
from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.monitor import Monitor
from uncal.monitor.verdict import OK, Verdict
from uncal.system.progress import LOG_INTERVAL

if TYPE_CHECKING:
    from rich.table import Table
    from typing_extensions import Self

log = logging.getLogger(__name__)

COLOURS = {"ok": "green", "drifting": "yellow", "recalibrate": "red", "untrusted": "magenta"}
SCALE = np.array([100.0] * 3 + [math.degrees(1.0)] * 3)
UNITS = ("cm",) * 3 + ("°",) * 3
EVENTS = 6
"""Changes of verdict that stay in view."""

BAR = 31
"""Characters of an interval's bar; its ends are the limits of the correction."""


class View:
    """Shows verdicts as they come.

    Args:
        monitor: for its limits.
    """

    def __init__(self, monitor: Monitor) -> None:
        self.limits = monitor.settings.limits.correction * SCALE
        self.widths = monitor.settings.limits.width * SCALE
        self.events: deque[str] = deque(maxlen=EVENTS)
        self.before = OK
        self.told = -math.inf
        self._live = None
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(auto_refresh=False)

    def __enter__(self) -> Self:
        """Begin to draw, where there is a terminal."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last picture on the terminal."""
        if self._live is not None:
            self._live.stop()

    def show(self, verdict: Verdict, rate: float) -> None:
        """Show the next verdict; in a log every change of verdict, and else now and then.

        Args:
            verdict: of a frame.
            rate: frames a second.
        """
        changed = verdict.verdict != self.before
        self.before = verdict.verdict
        said = f"{verdict.frame}: {verdict.verdict}, {verdict.reason}"
        if changed or verdict.updated:
            self.events.append(said)
        if self._live is not None:
            self._live.update(self.table(verdict, rate), refresh=True)
        elif changed or verdict.updated or time.monotonic() - self.told >= LOG_INTERVAL:
            self.told = time.monotonic()
            log.info("%s (%.1f frames a second)", said, rate)

    def table(self, verdict: Verdict, rate: float) -> Table:
        """Verdict, estimate, intervals against the limits, last events.

        Args:
            verdict: of a frame.
            rate: frames a second.
        """
        from rich.table import Table

        colour = COLOURS[verdict.verdict]
        table = Table(
            title=f"{verdict.frame} · {rate:.1f} frames a second\n"
            f"[bold {colour}]{verdict.verdict}[/]: {verdict.reason}",
            title_justify="left",
            caption="\n".join(["last events:", *self.events]) if self.events else None,
            caption_justify="left",
        )
        for name in ("DoF", "correction", "interval", "limit", "interval within the limits"):
            table.add_column(name)
        lower, upper = verdict.lower * SCALE, verdict.upper * SCALE
        for i, dof in enumerate(DOF_NAMES):
            table.add_row(
                dof,
                f"{verdict.correction[i] * SCALE[i]:+.2f} {UNITS[i]}",
                f"{lower[i]:+.2f} … {upper[i]:+.2f}",
                f"± {self.limits[i]:.3g} {UNITS[i]}",
                bar(lower[i], upper[i], self.limits[i]),
                style=self._style(verdict.correction[i] * SCALE[i], lower[i], upper[i], i),
            )
        return table

    def _style(self, correction: float, lower: float, upper: float, i: int) -> str:
        """Red beyond a limit, yellow where the interval excludes zero."""
        if abs(correction) > self.limits[i] or upper - lower > self.widths[i]:
            return "red"
        return "yellow" if lower > 0 or upper < 0 else ""

    @staticmethod
    def estimate(verdict: Verdict) -> str:
        """A line with the correction of each DoF and half the width of its interval.

        Args:
            verdict: of a frame.
        """
        half = (verdict.upper - verdict.lower) / 2 * SCALE
        parts = [
            f"{dof} {value:+.2f} ± {h:.2f} {unit}"
            for dof, value, h, unit in zip(
                DOF_NAMES, verdict.correction * SCALE, half, UNITS, strict=True
            )
        ]
        return f"Last estimate: {', '.join(parts)}"


def bar(lower: float, upper: float, limit: float) -> str:
    """An interval drawn between -limit and limit.

    Args:
        lower: of the interval.
        upper: of the interval.
        limit: at both ends of the bar.

    >>> bar(-1.0, 1.0, 2.0).strip("·")
    '━━━━━━━┿━━━━━━━'
    >>> bar(-math.inf, math.inf, 2.0) == "━" * 15 + "┿" + "━" * 15
    True
    """
    middle = BAR // 2
    drawn = []
    for place in range(BAR):
        inside = lower <= limit * (place - middle) / middle + limit / BAR and (
            upper >= limit * (place - middle) / middle - limit / BAR
        )
        if place == middle:
            drawn.append("┿" if inside else "│")
        else:
            drawn.append("━" if inside else "·")
    return "".join(drawn)
