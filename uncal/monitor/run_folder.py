"""What a monitor leaves on disk, and goes on from when it is started again."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
import torch

from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.monitor.monitor import Monitor
from uncal.monitor.sources import last_reported
from uncal.monitor.state import restore, state_of
from uncal.monitor.verdict import Verdict
from uncal.reporting.layout import replaced_whole

if TYPE_CHECKING:
    from typing_extensions import Self

LINES, TABLE, HISTORY, STATE = "monitor.jsonl", "monitor.csv", "extrinsics.jsonl", "state.pt"
"""Files of the folder."""

COLUMNS: tuple[str, ...] = (
    *("frame", "time", "verdict", "reason", "frames", "updated"),
    *(f"{part}_{dof.lower()}" for part in ("correction", "lower", "upper") for dof in DOF_NAMES),
)
"""Of the CSV; centimetres and degrees."""


class RunFolder:
    """Appends every verdict, then writes the state; a line that the state does not know is undone.

    Killed at any moment, what is on disk is therefore what the state knows and at most one line
    more, which is cut off before the monitor goes on.

    Args:
        folder: of the run.
        monitor: fresh; becomes what it was if the folder holds a state.
        about: what must be the same for going on, such as weights, source and settings.

    Raises:
        ConfigurationError: the folder holds the run of another monitor.

    Attributes:
        resumed: number of frames that were reported before.
        reported: last frame of each (rig, drive) that was.
    """

    def __init__(self, folder: Path, monitor: Monitor, about: Mapping[str, object]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.monitor = monitor
        self.about = json.loads(json.dumps(about))
        self.reported: dict[tuple[str, str], int] = {}
        self.resumed = 0
        self.counts: dict[str, int] = {}
        sizes = dict.fromkeys((LINES, TABLE, HISTORY), 0)
        path = folder / STATE
        if path.is_file():
            state = torch.load(path, map_location="cpu", weights_only=True)
            self._refuse_another(state["about"])
            restore(monitor, state["monitor"])
            sizes = state["sizes"]
        for name, size in sizes.items():
            (folder / name).touch()
            with (folder / name).open("rb+") as file:
                file.truncate(size)
        self._read_back()
        self._files = {name: (folder / name).open("a", encoding="utf-8") for name in sizes}
        if self._files[TABLE].tell() == 0:
            self._files[TABLE].write(",".join(COLUMNS) + "\n")

    def __enter__(self) -> Self:
        """Nothing to do: the files are open."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()

    def keep(self, verdict: Verdict) -> None:
        """Write a verdict, and the state after it.

        Args:
            verdict: of the next frame.
        """
        self.counts[verdict.verdict] = self.counts.get(verdict.verdict, 0) + 1
        self._files[LINES].write(json.dumps(verdict.as_json()) + "\n")
        self._files[TABLE].write(_row(verdict))
        if verdict.updated:
            change = self.monitor.history[-1]
            self._files[HISTORY].write(json.dumps(change.as_json()) + "\n")
        self.save()

    def record_revert(self) -> None:
        """Write the last change of the extrinsic in use, made between two frames."""
        change = self.monitor.history[-1]
        self._files[HISTORY].write(json.dumps(change.as_json()) + "\n")
        self.save()

    def save(self) -> None:
        """Write the state whole."""
        sizes = {}
        for name, file in self._files.items():
            file.flush()
            sizes[name] = file.tell()
        state = {"about": self.about, "sizes": sizes, "monitor": state_of(self.monitor)}
        with replaced_whole(self.folder / STATE) as partial:
            torch.save(state, partial)

    def _refuse_another(self, known: Mapping[str, object]) -> None:
        other = [key for key in {*known, *self.about} if known.get(key) != self.about.get(key)]
        if other:
            raise ConfigurationError(
                f"{self.folder}: holds the run of a monitor with another "
                f"{', '.join(sorted(other))}; go on with the same, or give another folder "
                "(hydra.run.dir=…)"
            )

    def _read_back(self) -> None:
        names = []
        with (self.folder / LINES).open(encoding="utf-8") as file:
            for line in file:
                said = json.loads(line)
                names.append(said["frame"])
                self.counts[said["verdict"]] = self.counts.get(said["verdict"], 0) + 1
        self.resumed = len(names)
        self.reported = last_reported(names)


def _row(verdict: Verdict) -> str:
    scale = np.array([100.0] * 3 + [np.degrees(1.0)] * 3)
    parts = (verdict.correction, verdict.lower, verdict.upper)
    numbers = [f"{value:.4f}" for part in parts for value in part * scale]
    text = io.StringIO()
    first = [verdict.frame, f"{verdict.time:.6f}", verdict.verdict, verdict.reason]
    csv.writer(text, lineterminator="\n").writerow(
        [*first, verdict.frames, int(verdict.updated), *numbers]
    )
    return text.getvalue()
