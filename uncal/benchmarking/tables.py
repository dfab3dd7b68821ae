"""The benchmark's tables and figure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from uncal.reporting.figures.style import BLUE, VERMILION
from uncal.reporting.frames import write_csv
from uncal.reporting.layout import write_whole

MARKERS = "osD^vP"

_LATENCY = {
    "network": "{case}",
    "frames": "{batch}",
    "dropout": "{dropout}",
    "contestant": "{contestant}",
    "ms": "{milliseconds:.1f}",
    "ratio": "{ratio:.2f} ({ratio_low:.2f}-{ratio_high:.2f})",
    "operations": "{operations:.2f}",
}

_TRADE = {
    "dropout": "{dropout}",
    "level": "{level:g}%",
    "ms": "{milliseconds:.1f}",
    "ratio": "{ratio:.2f}",
    "IS X-Z (cm)": "{is_translation:.2f}",
    "IS rotations (°)": "{is_rotation:.3f}",
    "MPIW X-Z (cm)": "{mpiw_translation:.2f}",
    "MPIW rotations (°)": "{mpiw_rotation:.3f}",
    "PICP mean (lowest-highest)": "{picp:.1f} ({picp_low:.1f}-{picp_high:.1f})",
    "MAE X-Z (cm)": "{mae_translation:.2f}",
    "MAE rotations (°)": "{mae_rotation:.3f}",
}
"""Heading → cell, made of a row's columns."""

_WORDS = ("network", "dropout", "contestant")


def write_latency(folder: Path, rows: pd.DataFrame, passes: int, rounds: int, where: str) -> str:
    """Write ``latency.csv`` and ``latency.md``; returns the text of the latter."""
    about = (
        f"{where}. Medians of {rounds} rounds in which all contestants of a block took turns; in "
        "brackets the smallest and largest ratio. Operations: multiplications and additions in the "
        "same units, the ratio on a machine that is never kept waiting."
    )
    title = f"{passes} stochastic passes in units of one deterministic pass"
    return _write(folder / "latency", rows, title, about, _LATENCY)


def write_trade(folder: Path, rows: pd.DataFrame, label: str, ckpt: str, where: str) -> str:
    """Write ``trade.csv``, ``trade.md`` and ``trade.png``; returns the text."""
    about = (
        f"The same weights ({ckpt}), calibrated and tested anew with dropout in fewer layers. "
        f"{where}; time for one frame, ratio to one deterministic pass."
    )
    _draw(folder / "trade.png", rows, label)
    return _write(folder / "trade", rows, f"Where dropout stands, on {label} data", about, _TRADE)


def _write(stem: Path, rows: pd.DataFrame, title: str, about: str, cells: Mapping[str, str]) -> str:
    write_csv(stem.with_suffix(".csv"), rows)
    rule = "|".join(":--" if heading in _WORDS else "--:" for heading in cells)
    lines = [f"# {title}", "", about, "", f"| {' | '.join(cells)} |", f"|{rule}|"]
    line = f"| {' | '.join(cells.values())} |"
    lines += [line.format(**{str(k): v for k, v in row.items()}) for _, row in rows.iterrows()]
    text = "\n".join(lines) + "\n"
    write_whole(stem.with_suffix(".md"), text)
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
