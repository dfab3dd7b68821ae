"""The benchmark's tables and figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from uncal.benchmarking.latency import LatencyRow
from uncal.benchmarking.trade import TradeRow
from uncal.reporting.layout import csv_text, write_whole

MARKERS = "osD^vP"
BLUE, ORANGE = "#0072B2", "#D55E00"
"""Of the colour-blind safe palette by Okabe and Ito."""


def write_latency(
    folder: Path, rows: Sequence[LatencyRow], passes: int, rounds: int, where: str
) -> str:
    """Write ``latency.csv`` and ``latency.md``."""
    _write_csv(folder / "latency.csv", rows)
    lines = [
        f"# {passes} stochastic passes in units of one deterministic pass",
        "",
        f"{where}. Medians of {rounds} rounds in which all contestants of a block took turns; in "
        "brackets the smallest and largest ratio. Operations: multiplications and additions in the "
        "same units, the ratio on a machine that is never kept waiting.",
        "",
        "| network | frames | dropout | contestant | ms | ratio | operations |",
        "|:--|--:|:--|:--|--:|--:|--:|",
    ]
    lines += [
        f"| {row.case} | {row.batch} | {row.dropout} | {row.contestant} "
        f"| {row.milliseconds:.1f} | {row.ratio:.2f} ({row.ratio_low:.2f}-{row.ratio_high:.2f}) "
        f"| {row.operations:.2f} |"
        for row in rows
    ]
    text = "\n".join(lines) + "\n"
    write_whole(folder / "latency.md", text)
    return text


def write_trade(folder: Path, rows: Sequence[TradeRow], label: str, ckpt: str, where: str) -> str:
    """Write ``trade.csv``, ``trade.md`` and ``trade.png``."""
    _write_csv(folder / "trade.csv", rows)
    lines = [
        f"# Where dropout stands, on {label} data",
        "",
        f"The same weights ({ckpt}), calibrated and tested anew with dropout in fewer layers. "
        f"{where}; time for one frame, ratio to one deterministic pass.",
        "",
        "| dropout | level | ms | ratio | IS X-Z (cm) | IS rotations (°) | MPIW X-Z (cm) "
        "| MPIW rotations (°) | PICP mean (lowest-highest) | MAE X-Z (cm) | MAE rotations (°) |",
        "|:--|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.dropout} | {r.level:g}% | {r.milliseconds:.1f} | {r.ratio:.2f} "
        f"| {r.is_translation:.2f} | {r.is_rotation:.3f} | {r.mpiw_translation:.2f} "
        f"| {r.mpiw_rotation:.3f} | {r.picp:.1f} ({r.picp_low:.1f}-{r.picp_high:.1f}) "
        f"| {r.mae_translation:.2f} | {r.mae_rotation:.3f} |"
        for r in rows
    ]
    text = "\n".join(lines) + "\n"
    write_whole(folder / "trade.md", text)
    _draw(folder / "trade.png", rows, label)
    return text


def _draw(path: Path, rows: Sequence[TradeRow], label: str) -> None:
    """Interval score against time, one panel for translation and one for rotation."""
    level = rows[0].level
    shown = [row for row in rows if row.level == level]
    with mpl.rc_context({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = figure.subplots(1, 2)
        kinds = (("X, Y, Z", "cm", BLUE), ("roll, pitch, yaw", "°", ORANGE))
        for panel, (name, unit, colour) in zip(panels, kinds, strict=True):
            values = [r.is_translation if unit == "cm" else r.is_rotation for r in shown]
            panel.plot([r.ratio for r in shown], values, "-", color=colour, alpha=0.5)
            for row, value, marker in zip(shown, values, MARKERS, strict=False):
                text = f"{row.dropout} (PICP {row.picp:.1f} %)"
                panel.plot(row.ratio, value, marker, color=colour, markersize=8, label=text)
            panel.margins(0.1)
            panel.legend(title="dropout", fontsize=8, title_fontsize=8, frameon=False)
            panel.set_xlabel("time of the passes / one deterministic pass")
            panel.set_ylabel(f"IS at {level:g} %, mean of {name} ({unit})")
        figure.suptitle(f"Dropout in fewer layers ({label} data)")
        figure.savefig(path, dpi=150)


def _write_csv(path: Path, rows: Sequence[LatencyRow] | Sequence[TradeRow]) -> None:
    columns = [field.name for field in fields(rows[0])]
    write_whole(path, csv_text(columns, (astuple(row) for row in rows)))
