"""The loop over a stream: read, judge, write, show; and where its time goes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Protocol

from uncal.monitor.monitor import Monitor
from uncal.monitor.run_folder import RunFolder
from uncal.monitor.sources import Unreadable
from uncal.monitor.verdict import Verdict
from uncal.monitor.view import View
from uncal.recordings.frame import Frame

STAGES: tuple[str, ...] = ("read", "edges", "start", "network", "passes", "decide", "write")
"""Where the time of a frame goes: reading it, edges of its sweep, the start's search, features and
rounds, stochastic passes, window and verdict, files and view."""


class Output(Protocol):
    """Something that verdicts go to."""

    def keep(self, number: int, frame: Frame | None, verdict: Verdict) -> None:
        """Take the next verdict.

        Args:
            number: of the frame in the stream.
            frame: None: it could not be read.
            verdict: of the frame.
        """
        ...

    def close(self) -> None:
        """Write what is waiting."""
        ...


class Loop:
    """Runs a monitor over a stream.

    Args:
        monitor: as it is to go on.
        run: where verdicts are written.
        outputs: where else.
        view: shows them; None: nothing does.

    Attributes:
        frames: seen so far.
        changes: of the extrinsic in use.
        last: verdict.
        seconds: spent in each of :data:`STAGES`.
    """

    def __init__(
        self, monitor: Monitor, run: RunFolder, outputs: Sequence[Output], view: View | None
    ) -> None:
        self.monitor = monitor
        self.run = run
        self.outputs = outputs
        self.view = view
        self.frames = 0
        self.changes = 0
        self.last: Verdict | None = None
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @property
    def rate(self) -> float:
        """Frames a second so far."""
        total = sum(self.seconds.values())
        return self.frames / total if total > 0 else 0.0

    def over(self, items: Iterable[Frame | Unreadable]) -> None:
        """Judge all that comes.

        Args:
            items: of a stream.
        """
        now = time.perf_counter()
        for item in items:
            now = self._spent("read", now)
            inside = dict(self.monitor.reader.seconds)
            if isinstance(item, Unreadable):
                verdict, frame = self.monitor.missing(item.id, item.reason), None
            else:
                verdict, frame = self.monitor.update(item), item
            now = self._spent("decide", now)
            for stage, seconds in self.monitor.reader.seconds.items():
                self.seconds[stage] += seconds - inside[stage]
                self.seconds["decide"] -= seconds - inside[stage]
            number = self.run.resumed + self.frames
            self.run.keep(verdict)
            for output in self.outputs:
                output.keep(number, frame, verdict)
            self.frames += 1
            self.changes += verdict.updated
            self.last = verdict
            if self.view is not None:
                self.view.show(verdict, self.rate)
            now = self._spent("write", now)

    def shares(self) -> str:
        """Frames a second and the share of each stage, for people."""
        total = sum(self.seconds.values())
        if not self.frames or total <= 0:
            return ""
        parts = ", ".join(f"{name} {100 * self.seconds[name] / total:.0f} %" for name in STAGES)
        return f"{self.rate:.1f} frames a second: {parts}"

    def _spent(self, stage: str, since: float) -> float:
        now = time.perf_counter()
        self.seconds[stage] += now - since
        return now


def outputs_of(
    monitor: Monitor, folder: Path, begun: int, tensorboard: bool, overlays: int, rerun: bool
) -> list[Output]:
    """What verdicts go to beside the files of the run.

    Args:
        monitor: that gives them.
        folder: of the run.
        begun: number of frames that an earlier part of the run has shown.
        tensorboard: whether curves are written.
        overlays: a picture of every n-th frame; 0: none.
        rerun: whether a recording for the viewer is written.

    Raises:
        ConfigurationError: rerun is not installed.
    """
    made: list[Output] = []
    if rerun:  # first, since it may be missing
        from uncal.monitor.rerun_recording import RerunRecording

        name = f"monitor_{begun}.rrd" if begun else "monitor.rrd"
        made.append(RerunRecording(folder / name, monitor.reader))
    if tensorboard:
        from uncal.monitor.curves import Curves

        made.append(Curves(folder / "tensorboard", begun))
    if overlays:
        from uncal.monitor.pictures import Pictures

        made.append(Pictures(folder / "overlays", overlays, monitor.reader))
    return made
