"""The result of a run: the paper's table on the terminal and in the run folder."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import lightning
import pandas as pd
from lightning import LightningModule, Trainer

from uncal import __version__
from uncal.data.datamodule import WINDOWED, CalibrationDataModule
from uncal.models.module import CalibrationModule
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.frames import write_csv
from uncal.reporting.measure import measure
from uncal.reporting.report import format_report, write_report

SPREAD_NOTES = {
    "solver": "σ is the covariance of the least-squares solver (mcd.spread=solver).",
    "total": "σ is dropout's and the solver's, added in quadrature (mcd.spread=total).",
}
"""What a table says of a σ that is not the paper's."""


class Report(lightning.Callback):
    """Writes the tables of :func:`write_report` and ``skipped.csv`` when a test ends.

    Args:
        folder: the run's folder.
        levels: coverage levels of the table.
        label: what the data are, such as "simulated"; stands in every heading.
    """

    def __init__(self, folder: str, levels: Sequence[float], label: str) -> None:
        self.folder = Path(folder)
        self.levels = list(levels)
        self.label = label

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Make the table, write it, show it."""
        if not isinstance(pl_module, CalibrationModule) or pl_module.run.tested is None:
            return
        run, tested = pl_module.run, pl_module.run.tested
        data = trainer.datamodule  # type: ignore[attr-defined]  # Lightning sets it in test()
        frames = data.named("test")
        groups = tested.groups(frames, pl_module.groups)
        predicted = (tested.mean, tested.std, tested.target)
        results = measure(
            Evaluation(*predicted, pl_module.calibrator, groups, tested.bounds),
            self.levels,
            control=None if run.control is None else run.control.among(tested.index),
            frames=[str(frames[i]) for i in tested.index.tolist()],
            ellipsoid=(pl_module.ellipsoid, tested.covariance),
        )
        run.mean_ratio = float(results.summary.mean_ratio)
        data.share_skipped()
        if not trainer.is_global_zero:
            return
        notes = [*run_notes(pl_module, data), *skip_notes(data.skipped)]
        paths = write_report(self.folder, results, label=self.label, notes=notes)
        if data.skipped:
            write_skipped(self.folder / "skipped.csv", data.skipped)
        table = format_report(results, label=self.label, notes=notes)
        files = "\n".join(str(path) for path in paths)
        sys.stdout.write(f"\n{table}\n\n{files}\n")
        sys.stdout.flush()


def run_notes(module: CalibrationModule, data: CalibrationDataModule) -> list[str]:
    """What a reader must know to place the numbers, one sentence each."""
    sizes = ", ".join(f"{len(ids)} {name.replace('_', ' ')}" for name, ids in data.splits.items())
    notes = [
        f"Split by {data.split_by}: {sizes} frames. {_passes(module)}, intervals of kind "
        f"{module.calibrator.kind}, seed {data.seed}, uncal {__version__}.",
    ]
    if data.window.frames > 1:
        counts = ", ".join(f"{len(data.units[name])} {name.replace('_', ' ')}" for name in WINDOWED)
        notes.append(
            f"One estimate per window of {data.window.frames} consecutive frames ({counts} "
            "windows): the numbers below count windows, and intervals are calibrated on windows."
        )
        units = [unit for name in WINDOWED for unit in data.units[name]]
        if shorter := sum(len(unit) < data.window.frames for unit in units):
            notes.append(
                f"{shorter} of the {len(units)} windows have fewer than {data.window.frames} "
                "frames: their drives (or what a split holds of them) are no longer."
            )
    if module.spread != "dropout":
        notes.append(SPREAD_NOTES[module.spread])
    if data.split_note:
        notes.append(data.split_note)
    tested = {frame.rig for frame in data.named("test")}
    others = [ids for name, ids in data.splits.items() if name != "test"]
    held_out = tested.isdisjoint(frame.rig for ids in others for frame in ids)
    came_from = (
        f"The test frames come from {len(tested)} held-out rig(s), absent from training and "
        "calibration. "
    )
    if held_out or data.split_by != "frame":
        notes.append(
            f"{came_from if held_out else ''}Frames of one {'rig' if held_out else 'drive'} are "
            "dependent, so the reference band, which assumes exchangeable frames, is for reference "
            "only here."
        )
    return [*notes, *module.run.notes]


def _passes(module: CalibrationModule) -> str:
    if module.engine.passes == 1:
        return "One pass without dropout"
    masks = "fresh" if module.masks is None else "fixed"
    return f"{module.engine.passes} stochastic passes with {masks} masks"


def skip_notes(skipped: Mapping[str, str], shown: int = 10) -> list[str]:
    """How many frames were skipped, and the first of them with the reason; none without.

    >>> skip_notes({"rig/drive/0000000003": "truncated"})
    ['1 frame skipped (all in skipped.csv).', 'Skipped rig/drive/0000000003: truncated']
    """
    frames = "1 frame" if len(skipped) == 1 else f"{len(skipped)} frames"
    first = [f"Skipped {frame}: {reason}" for frame, reason in list(skipped.items())[:shown]]
    return [f"{frames} skipped (all in skipped.csv).", *first] if skipped else []


def write_skipped(path: Path, skipped: Mapping[str, str]) -> None:
    """Write frame and reason of every skipped frame."""
    write_csv(path, pd.DataFrame(sorted(skipped.items()), columns=["frame", "reason"]))
