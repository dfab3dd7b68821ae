"""How often intervals hold the whole pose: six at once, the joint box, Bonferroni's."""

from __future__ import annotations

from collections.abc import Sequence

from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BAND_GREY,
    BLUE,
    GREEN,
    GREY,
    SINGLE_COLUMN,
    VERMILION,
    light_grid,
    new_figure,
    paper_style,
)
from uncal.reporting.joint_rows import JointRow

_CURVES = (
    ("together", "six intervals at once", VERMILION, "--", "s"),
    ("joint", "joint box", BLUE, "-", "o"),
    ("bonferroni", "Bonferroni box", GREEN, "-.", "^"),
)


def joint_coverage(
    rows: Sequence[JointRow], label: str, yardstick: str | None = None
) -> NamedFigure:
    """Coverage of the whole pose against the level asked for.

    Args:
        rows: :func:`uncal.reporting.joint_rows.joint_rows`.
        label: what the data are, such as "simulated".
        yardstick: :func:`uncal.reporting.figures.calibration_curves.why_yardstick`; None where it
            is not known.
    """
    rows = sorted(rows, key=lambda row: row.level)
    boxes = [row for row in rows if row.joint_low is not None and row.joint_high is not None]
    with paper_style():
        figure, (panel,) = new_figure(1, 1, width=SINGLE_COLUMN, height=2.9, label=label)
        light_grid([panel])
        panel.fill_between(
            [row.level for row in boxes],
            [row.joint_low or 0.0 for row in boxes],
            [row.joint_high or 0.0 for row in boxes],
            color=BAND_GREY,
            label="allowed for the joint box" if yardstick == "" else "yardstick for the joint box",
        )
        panel.axline((0, 0), slope=1, color=GREY, linestyle=":", linewidth=0.8)
        for name, words, colour, line, marker in _CURVES:
            known = [(row.level, getattr(row, name)) for row in rows]
            shown = [(level, value) for level, value in known if value is not None]
            if shown:
                levels, values = zip(*shown, strict=True)
                panel.plot(
                    levels, values, color=colour, linestyle=line, marker=marker, label=words,
                    clip_on=False, zorder=3,
                )  # fmt: skip
        low = min(row.level for row in rows) - 5
        panel.set_xlim(low, 100)
        panel.set_ylim(0 if low < 60 else min(low, *(row.together for row in rows)) - 5, 100)
        panel.set_xlabel("Coverage asked for (%)")
        panel.set_ylabel("Whole pose held (%)")
        # Above, since no corner is free of curves whatever the levels are.
        figure.legend(loc="outside upper center", ncols=2)
    return NamedFigure("joint_coverage", "The whole pose", _caption(rows, yardstick), figure)


def _caption(rows: Sequence[JointRow], yardstick: str | None) -> str:
    first = rows[-1] if len(rows) == 1 else min(rows, key=lambda row: abs(row.level - 90.0))
    says = f"Of {first.n_test} test frames, all six {first.level:g} % intervals hold at once in "
    says += f"{first.together:.1f} %"
    if first.joint is not None:
        says += f", the joint box in {first.joint:.1f} %"
    band = " Shaded: the band of the exact law at 99.9 %"
    if yardstick is None:
        band += ", if frames are exchangeable."
    else:
        band += f", only a yardstick here: {yardstick}." if yardstick else "."
    return f"{says}.{band} Dotted: as often as asked for."
