"""All figures of a multirun, from its summary.csv."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.drawing import COLOURS, dots, lines
from uncal.multirun.frame import SUMMARY, read_summary
from uncal.multirun.summary import CAPTIONS, FIGURES
from uncal.multirun.sweep import Panel, Quantity, Sweep, key_name
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures.named import NamedFigure, save
from uncal.reporting.figures.style import paper_style
from uncal.reporting.layout import csv_text, write_whole

_KINDS = (("Translation", DOF_UNITS[0], DOF_NAMES[:3]), ("Rotation", DOF_UNITS[3], DOF_NAMES[3:]))
_ERRORS = {"mae_after": "MC mean", "mae_single": "one pass without dropout"}
_POSE = {"together": "six at once", "joint": "joint box", "bonferroni": "Bonferroni"}
_WIDTHS = (
    ("interval_score", "Interval score", "is"),
    ("interval_width", "Mean width", "mpiw"),
)

_LAW = (
    "Shaded: where the Beta-Binomial law of split conformal intervals puts one degree of freedom "
    f"with probability {100 * BAND_CONFIDENCE:g} % if frames are exchangeable; for reference only "
    "with other methods and splits."
)
_POSE_WORDS = (
    "Empirical coverage of all six degrees of freedom at once: by the six intervals together, "
    "which is not guaranteed, by the joint box and by Bonferroni's. Dotted: nominal."
)
_ERROR_WORDS = (
    "Mean absolute error of the estimate: mean over X, Y, Z to the left, over roll, pitch, yaw to "
    "the right."
)
_CAMERA_WORDS = (
    "How much larger the mean absolute error gets when the network sees another frame's image, "
    "relative to the mean decalibration. At 0 it calibrates blind."
)


def sweep_figures(folder: Path) -> list[NamedFigure]:
    """Every figure that a multirun's ``summary.csv`` allows; none if there is nothing to compare.

    Over a swept number, such as ``mcd.passes``, lines; another swept key gives one line per value.
    Without a number, or with more lines than can be told apart, a row of dots per combination.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    frame = read_summary(folder / SUMMARY)
    if frame is None:
        return []
    sweep = Sweep(frame)
    if len(sweep.groups) < 2 and sweep.replicates < 2:
        return []
    as_lines = sweep.over is not None and len(sweep.others) <= len(COLOURS)
    with paper_style():
        return [*(_over_a_number(sweep) if as_lines else _by_name(sweep)), *_camera(sweep)]


def draw_figures(folder: Path) -> list[Path]:
    """Save the figures of a multirun, and their captions for its ``summary.md``.

    Returns:
        The PNG files, in ``<folder>/figures``, each with a PDF beside it.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    figures, target = sweep_figures(folder), folder / FIGURES
    paths = [save(figure, target)[0] for figure in figures]
    listed = target / CAPTIONS
    if figures or listed.exists():
        for name in _listed(listed) - {figure.name for figure in figures}:
            for suffix in (".png", ".pdf"):
                (target / f"{name}{suffix}").unlink(missing_ok=True)
        rows = ([figure.name, figure.title, figure.caption] for figure in figures)
        write_whole(listed, csv_text(("name", "title", "caption"), rows))
    return paths


def _over_a_number(sweep: Sweep) -> Iterator[NamedFigure]:
    assert sweep.over is not None
    against, alone = f"against {key_name(sweep.over)}", not sweep.others

    def figure(
        name: str, title: str, caption: str, panels: Sequence[Panel], columns: int
    ) -> NamedFigure:
        drawn = lines(sweep, panels, columns)
        return NamedFigure(name, f"{title} {against}", f"{caption} {sweep.spread}", drawn)

    for name, title, column in _WIDTHS:
        panels = [
            Panel(f"{kind}, {v:g} % intervals", f"{title} ({unit})", {"": (column, v, dofs)})
            for v in sweep.levels
            if len(sweep.values((column, v, DOF_NAMES)))
            for kind, unit, dofs in _KINDS
        ]
        caption = f"{title} {against}, at each nominal level: mean over X, Y, Z to the left, over "
        if panels:
            yield figure(name, title, caption + "roll, pitch, yaw to the right.", panels, 2)
    coverage = _coverage(sweep, by_dof=alone)
    mean = "" if alone else ", mean over the six degrees of freedom"
    caption = f"Empirical coverage{' per degree of freedom' if alone else mean}; dotted: nominal."
    caption += f" {_LAW}" if alone else ""
    yield figure("coverage", "Coverage", caption, coverage, len(coverage))
    if alone and "together" in sweep.frame.columns:
        yield figure("whole_pose", "Whole pose", _POSE_WORDS, _pose(sweep), len(sweep.levels))
    yield figure("point_error", "Point error", _ERROR_WORDS, _errors(sweep, both=alone), 2)


def _by_name(sweep: Sweep) -> Iterator[NamedFigure]:
    level = sweep.levels[0]

    def figure(name: str, title: str, caption: str, panels: Sequence[Panel]) -> NamedFigure:
        words = f"{caption} {sweep.spread}"
        return NamedFigure(name, f"{title} by {sweep.words}", words, dots(sweep, panels))

    caption = f"Empirical coverage per degree of freedom; dotted: nominal. {_LAW}"
    yield figure("coverage", "Coverage", caption, _coverage(sweep, by_dof=True))
    widths = [
        Panel("", f"{title} relative to the first row", _by_dof(column, level), 1.0, relative=True)
        for _, title, column in reversed(_WIDTHS)
    ]
    first = [sweep.values((column, level, DOF_NAMES)) for _, _, column in _WIDTHS]
    if len(sweep.groups) > 1 and all((each["row"] == 0).any() for each in first):
        caption = (
            f"Mean width (MPIW) and interval score (IS) of {level:g} % intervals, each degree of "
            f"freedom divided by its own in the row “{sweep.names[0]}”. Narrow intervals are "
            "better only if they cover: the interval score counts misses too."
        )
        yield figure("interval_width", "Interval width", caption, widths)
    if "together" in sweep.frame.columns:
        yield figure("whole_pose", "Whole pose", _POSE_WORDS, _pose(sweep))
    # The same in all rows with interval methods.
    if sweep.differs(Panel("", "", {n: (c, level, DOF_NAMES) for c, n in _ERRORS.items()})):
        yield figure("point_error", "Point error", _ERROR_WORDS, _errors(sweep, both=True))


def _camera(sweep: Sweep) -> Iterator[NamedFigure]:
    """None if it is unknown, or the same in all rows, as with stochastic passes."""
    axis = "What the camera contributes (% of the decalibration)"
    panel = Panel("", axis, _by_dof("contribution", sweep.levels[0]), 0.0)
    if sweep.differs(panel):
        own = sweep.replicates == 1
        words = "Bars: 95 % bootstrap intervals." if own else sweep.spread
        title = f"What the camera contributes by {sweep.words}"
        figure = dots(sweep, [panel], own_bars=own)
        yield NamedFigure("camera", title, f"{_CAMERA_WORDS} {words}", figure)


def _coverage(sweep: Sweep, *, by_dof: bool) -> list[Panel]:
    return [
        Panel(
            f"{v:g} % intervals",
            "Empirical coverage (%)",
            _by_dof("picp", v) if by_dof else {"": ("picp", v, DOF_NAMES)},
            reference=v,
            law=by_dof,
        )
        for v in sweep.levels
    ]


def _pose(sweep: Sweep) -> list[Panel]:
    axis = "All six DoF held (%)"
    return [
        Panel(f"{v:g} %", axis, {name: (c, v, DOF_NAMES) for c, name in _POSE.items()}, v)
        for v in sweep.levels
    ]


def _errors(sweep: Sweep, *, both: bool) -> list[Panel]:
    level = sweep.levels[0]  # the errors are the same at all
    shown = _ERRORS if both else {"mae_after": ""}
    return [
        Panel(kind, f"Mean absolute error ({unit})", {n: (c, level, d) for c, n in shown.items()})
        for kind, unit, d in _KINDS
    ]


def _by_dof(column: str, level: float) -> dict[str, Quantity]:
    return {dof: (column, level, [dof]) for dof in DOF_NAMES}


def _listed(path: Path) -> set[str]:
    if not path.exists():
        return set()
    with path.open(encoding="utf-8", newline="") as file:
        return {row["name"] for row in csv.DictReader(file)}
