"""The benchmark's tables and figure."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from uncal.reporting.figures.style import BLUE, VERMILION
from uncal.reporting.frames import write_csv
from uncal.reporting.layout import write_whole

MARKERS = "osD^vP"


def write_latency(folder: Path, rows: pd.DataFrame, passes: int, rounds: int, where: str) -> str:
    """Write ``latency.csv`` and ``latency.md``."""
    write_csv(folder / "latency.csv", rows)
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
        for row in rows.itertuples()
    ]
    text = "\n".join(lines) + "\n"
    write_whole(folder / "latency.md", text)
    return text


def write_trade(folder: Path, rows: pd.DataFrame, label: str, ckpt: str, where: str) -> str:
    """Write ``trade.csv``, ``trade.md`` and ``trade.png``."""
    write_csv(folder / "trade.csv", rows)
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
        for r in rows.itertuples()
    ]
    text = "\n".join(lines) + "\n"
    write_whole(folder / "trade.md", text)
    _draw(folder / "trade.png", rows, label)
    return text


def _draw(path: Path, rows: pd.DataFrame, label: str) -> None:
    """Interval score against time, one panel for translation and one for rotation."""
    level = rows["level"].iloc[0]
    shown = rows[rows["level"] == level]
    with mpl.rc_context({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = figure.subplots(1, 2)
        kinds = (
            ("is_translation", "X, Y, Z (cm)", BLUE),
            ("is_rotation", "roll, pitch, yaw (°)", VERMILION),
        )
        for panel, (column, name, colour) in zip(panels, kinds, strict=True):
            panel.plot(shown["ratio"], shown[column], "-", color=colour, alpha=0.5)
            for (_, row), marker in zip(shown.iterrows(), MARKERS, strict=False):
                looks = {"color": colour, "markersize": 8, "marker": marker}
                text = f"{row['dropout']} (PICP {row['picp']:.1f} %)"
                panel.plot(row["ratio"], row[column], **looks, label=text)
            panel.margins(0.1)
            panel.legend(title="dropout", fontsize=8, title_fontsize=8, frameon=False)
            panel.set_xlabel("time of the passes / one deterministic pass")
            panel.set_ylabel(f"IS at {level:g} %, mean of {name}")
        figure.suptitle(f"Dropout in fewer layers ({label} data)")
        figure.savefig(path, dpi=150)
