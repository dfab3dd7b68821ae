"""All figures of a multirun, from its frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
from torch.utils.tensorboard import SummaryWriter

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.drawing import COLOURS, Panel, dots, lines
from uncal.multirun.folder import CAPTIONS, FIGURES, read_captions
from uncal.multirun.sweep import Quantity, Sweep, key_name
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures.style import NamedFigure, paper_style, save
from uncal.reporting.frames import write_csv
from uncal.reporting.tensorboard import add_png

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


def sweep_figures(frame: pd.DataFrame) -> list[NamedFigure]:
    """Every figure that a multirun allows; none if there is nothing to compare.

    Over a swept number, such as ``mcd.passes``, lines; another swept key gives one line per value.
    Without a number, or with more lines than can be told apart, a row of dots per combination.
    """
    sweep = Sweep(frame)
    if len(sweep.groups) < 2 and sweep.replicates < 2:
        return []
    with paper_style():
        return list(_figures(sweep))


def draw_figures(folder: Path, frame: pd.DataFrame) -> list[Path]:
    """Save PNG (returned) and PDF of a multirun's figures, and their captions for summary.md."""
    figures, target = sweep_figures(frame), folder / FIGURES
    paths = [save(figure, target)[0] for figure in figures]
    earlier = {name for name, _, _ in read_captions(folder)}
    for name in earlier - {figure.name for figure in figures}:
        for suffix in (".png", ".pdf"):
            (target / f"{name}{suffix}").unlink(missing_ok=True)
    if figures or earlier:
        rows = [(figure.name, figure.title, figure.caption) for figure in figures]
        write_csv(target / CAPTIONS, pd.DataFrame(rows, columns=["name", "title", "caption"]))
    return paths


def show_in_tensorboard(pictures: Sequence[Path], folder: Path) -> None:
    """Write pictures into one TensorBoard file of their own, in place of an earlier one."""
    for earlier in folder.glob("events.out.tfevents.*"):
        earlier.unlink(missing_ok=True)
    with SummaryWriter(str(folder)) as writer:
        for path in pictures:
            add_png(writer, f"multirun/{path.stem}", path)


def _figures(sweep: Sweep) -> Iterator[NamedFigure]:
    as_lines = sweep.over is not None and len(sweep.others) <= len(COLOURS)
    by_dof = not (as_lines and sweep.others)
    suffix = f"against {key_name(sweep.over)}" if sweep.over and as_lines else f"by {sweep.words}"
    level = sweep.levels[0]

    def figure(
        name: str, title: str, caption: str, panels: list[Panel], columns: int = 2
    ) -> NamedFigure:
        drawn = lines(sweep, panels, columns) if as_lines else dots(sweep, panels)
        return NamedFigure(name, f"{title} {suffix}", f"{caption} {sweep.spread}", drawn)

    if as_lines:
        for name, title, column in _WIDTHS:
            caption = f"{title} {suffix}, at each nominal level: mean over X, Y, Z to the left, "
            panels = [
                Panel(f"{kind}, {v:g} % intervals", f"{title} ({unit})", {"": (column, v, dofs)})
                for v in sweep.levels
                if len(sweep.values((column, v, DOF_NAMES)))
                for kind, unit, dofs in _KINDS
            ]
            if panels:
                yield figure(name, title, caption + "over roll, pitch, yaw to the right.", panels)
    axis = "Empirical coverage (%)"
    coverage = [
        Panel(f"{v:g} % intervals", axis, series, reference=v, law=v if by_dof else None)
        for v in sweep.levels
        for series in [_by_dof("picp", v) if by_dof else {"": ("picp", v, DOF_NAMES)}]
    ]
    mean = " per degree of freedom" if by_dof else ", mean over the six degrees of freedom"
    caption = f"Empirical coverage{mean}; dotted: nominal." + (f" {_LAW}" if by_dof else "")
    yield figure("coverage", "Coverage", caption, coverage, len(coverage))
    first = [sweep.values((column, level, DOF_NAMES)) for _, _, column in _WIDTHS]
    everywhere = all((each["row"] == 0).any() for each in first)
    if not as_lines and len(sweep.groups) > 1 and everywhere:
        caption = (
            f"Mean width (MPIW) and interval score (IS) of {level:g} % intervals, each degree of "
            f"freedom divided by its own in the row “{sweep.names[0]}”. Narrow intervals are "
            "better only if they cover: the interval score counts misses too."
        )
        axes = {f"{title} relative to the first row": column for _, title, column in _WIDTHS}
        widths = [
            Panel("", axis, _by_dof(column, level), 1, relative=True)
            for axis, column in reversed(axes.items())
        ]
        yield figure("interval_width", "Interval width", caption, widths)
    if by_dof and "together" in sweep.frame.columns:
        axis = "Held (%)"
        pose = [
            Panel(f"{v:g} %", axis, {n: (c, v, DOF_NAMES) for c, n in _POSE.items()}, reference=v)
            for v in sweep.levels
        ]
        yield figure("whole_pose", "Whole pose", _POSE_WORDS, pose, len(pose))
    # The same at all levels, and with interval methods in all rows.
    shown = _ERRORS if by_dof else {"mae_after": ""}
    if as_lines or sweep.differs((column, level, DOF_NAMES) for column in shown):
        axis = "Mean absolute error"
        errors = [
            Panel(kind, f"{axis} ({unit})", {n: (c, level, dofs) for c, n in shown.items()})
            for kind, unit, dofs in _KINDS
        ]
        yield figure("point_error", "Point error", _ERROR_WORDS, errors)

    # None if it is unknown, or the same in all rows, as with stochastic passes.
    series = _by_dof("contribution", level)
    if sweep.differs(series.values()):
        own = sweep.replicates == 1
        words = "Bars: 95 % bootstrap intervals." if own else sweep.spread
        title = f"What the camera contributes by {sweep.words}"
        panel = Panel("", "What the camera contributes (% of the decalibration)", series, 0.0)
        drawn = dots(sweep, [panel], own_bars=own)
        yield NamedFigure("camera", title, f"{_CAMERA_WORDS} {words}", drawn)


def _by_dof(column: str, level: float) -> dict[str, Quantity]:
    return {dof: (column, level, [dof]) for dof in DOF_NAMES}
