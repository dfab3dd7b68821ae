"""The tables of a run as DataFrames: what their columns mean, and how they become CSV and back.

A table is a tidy frame from the moment it is measured; files, terminal and pages are renderings of
it. A column's kind follows from its name, so that the CSV reads back as it was measured.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.layout import write_whole

_KINDS: dict[str, str] = {
    **dict.fromkeys(("dof", "unit", "by", "groups", "frame"), "text"),
    **dict.fromkeys(("n_test", "n_calibration", "n", "n_groups", "bin"), "integer"),
    **dict.fromkeys(("in_band", "joint_in_band"), "truth"),
    **dict.fromkeys(("truth", "estimate", "sigma"), "number, not NaN"),
}
"""Kinds of columns by name; bounds are like estimates, all others numbers that may be NaN."""

_PARSERS: dict[str, Callable[[str], object]] = {
    "text": str,
    "integer": int,
    "truth": {"True": True, "False": False}.__getitem__,
    "number": float,
}
"""Kind → reader of a cell; Python's own ``float`` reads a decimal back exactly."""

_DOF = {"dof": "X, Y, Z, Roll, Pitch or Yaw", "unit": '"cm" or "°", of all lengths in the row'}
_SIZES = {
    "n_test": "samples of the test set",
    "n_calibration": "samples of the uncertainty calibration set",
}


@dataclass(frozen=True, eq=False)
class Schema:
    """A CSV file of a run's folder.

    Attributes:
        file: its name.
        columns: name → meaning; coverage, levels and bands are percent.
        complete: columns whose every combination has a row for each of the six DoF; None: no check.
        lost: what a report cannot show without the file.
    """

    file: str
    columns: Mapping[str, str]
    complete: tuple[str, ...] | None
    lost: str


RESULTS = Schema(
    "results.csv",
    {
        **_DOF,
        "level": "nominal coverage",
        "picp": "empirical coverage (prediction interval coverage probability)",
        "mpiw": "mean prediction interval width; inf if the uncertainty calibration set is too "
        "small for the level",
        "is": "mean interval score",
        "coverage_low": "lower end of the Beta-Binomial law's reference band; it holds for split "
        "conformal intervals, for other methods it is for reference only",
        "coverage_high": "its upper end",
        "in_band": "whether picp lies in that band",
        "mae_before": "mean |decalibration|",
        "mae_after": "mean |decalibration - estimate|",
        "ratio": "mae_after / mae_before; NaN without decalibration on this DoF",
        **_SIZES,
    },
    complete=("level",),
    lost="the results",
)

JOINT = Schema(
    "joint.csv",
    {
        "level": "nominal coverage",
        "together": "how often all six per-DoF intervals hold at once; not guaranteed",
        "joint": "empirical coverage of the joint box, from the largest score of the six DoF",
        "joint_low": "lower end of the Beta-Binomial law's reference band for the joint box",
        "joint_high": "its upper end",
        "joint_in_band": "whether joint lies in that band",
        "bonferroni": "empirical coverage of the box of six intervals at level 1 - α/6",
        "bonferroni_size": "its width per DoF over the joint box's (geometric mean); inf if only "
        "it is infinite, NaN if both are",
        "ellipsoid": "empirical coverage of the joint ellipsoid, from the Mahalanobis distance",
        "ellipsoid_size": "the joint box's width per DoF over the ellipsoid's (sixth root of the "
        "ratio of their volumes, geometric mean over frames); NaN where there is no ellipsoid",
        **_SIZES,
    },
    complete=None,
    lost="the joint coverage",
)

CONDITIONAL = Schema(
    "conditional.csv",
    {
        "by": "what bins the test set: sigma (of the DoF), decalibration (its absolute value), "
        "translation (length over X, Y, Z) or rotation (angle of the whole)",
        "dof": _DOF["dof"],
        "level": "nominal coverage",
        "bin": "1 for the lowest values",
        "unit": '"cm" or "°", of value_from and value_to',
        "value_from": "smallest value that belongs to the bin",
        "value_to": "where the next bin starts; in the last bin the largest value",
        "n": "samples in the bin; ties can make bins unequal, or empty",
        "picp": "empirical coverage; NaN in an empty bin",
        "coverage_low": "lower end of the reference band for n samples. It is exact only for bins "
        "independent of the score: conformal coverage is guaranteed over all frames, not per bin",
        "coverage_high": "its upper end",
    },
    complete=("by", "level", "bin"),
    lost="the coverage by σ and by size of the decalibration",
)

CURVE = Schema(
    "calibration_curve.csv",
    {
        name: RESULTS.columns[name]
        for name in ("dof", "level", "picp", "coverage_low", "coverage_high", "in_band")
    },
    complete=("level",),
    lost="the calibration curve",
)

CONTROL = Schema(
    "control.csv",
    {
        **_DOF,
        "mae_before": "mean |decalibration|",
        "mae_mean": "mean absolute error of the mean of the stochastic passes, as mae_after of "
        "results.csv",
        "mae_single": "the same of one pass without dropout",
        "mae_blind": "the same of that pass on another frame's image",
        "contribution": "(mae_blind - mae_single) / mae_before, percent",
        "contribution_low": "lower end of its 95% interval",
        "contribution_high": "its upper end",
        "n": "frames",
        "groups": "the unit of the bootstrap: rigs, drives or frames",
        "n_groups": "how many there are",
    },
    complete=(),
    lost="the image-blind control and the error without dropout",
)

PREDICTIONS = Schema(
    "predictions.csv",
    {
        "frame": "name of the frame, unique in its recording",
        **_DOF,
        "truth": "true decalibration",
        "estimate": "estimated decalibration, mean of the stochastic passes",
        "sigma": "its standard deviation",
        # and per level lower_90, upper_90, …: the interval; see bound_columns
    },
    complete=("frame",),
    lost="the error of the whole pose and the ordered intervals",
)

TABLES = (RESULTS, JOINT, CONDITIONAL, CURVE, CONTROL, PREDICTIONS)


def bound_columns(level: float) -> tuple[str, str]:
    """The two columns of predictions.csv that have a level's intervals.

    >>> bound_columns(90.0)
    ('lower_90', 'upper_90')
    """
    return f"lower_{level:.12g}", f"upper_{level:.12g}"


def bound_levels(frame: pd.DataFrame) -> list[float]:
    """Nominal coverages of the intervals in a frame of predictions, percent, ascending."""
    return sorted(float(name[6:]) for name in frame.columns if name.startswith("lower_"))


def csv_text(frame: pd.DataFrame) -> str:
    """A frame as CSV; floats are their shortest text that reads back exactly."""
    return frame.to_csv(index=False, lineterminator="\n", na_rep="nan")


def write_csv(path: Path, frame: pd.DataFrame) -> Path:
    """Write :func:`csv_text` whole or not at all."""
    return write_whole(path, csv_text(frame))


def read_csv(path: Path, schema: Schema) -> pd.DataFrame:
    """Read what :func:`write_csv` wrote, and check that it is all there.

    Raises:
        UncalError: the file cannot be read, is cut off, lacks a column, a value or a DoF, or has a
            value of another kind.
    """
    try:
        content = path.read_text(encoding="utf-8")
        cells = pd.read_csv(io.StringIO(content), dtype=str, keep_default_na=False)
        wanted = list(schema.columns)
        if schema is PREDICTIONS:
            lowers = [name for name in cells.columns if name.startswith("lower_")]
            wanted += [name for lower in lowers for name in bound_columns(float(lower[6:]))]
        if missing := [name for name in wanted if name not in cells.columns]:
            raise ValueError(f"no column {', '.join(missing)}")
        if cells.empty:
            raise ValueError("it has no rows")
        frame: pd.DataFrame = pd.DataFrame(
            {name: _parsed(cells[name], name in wanted) for name in cells.columns}
        )
        if not content.endswith("\n"):
            raise ValueError("the last line is cut off")
        _check_complete(frame, schema)
    except (OSError, ValueError) as error:
        raise UncalError(
            f"{path} is damaged: {error}. Expected a line per row with "
            f"{', '.join(schema.columns)}, as uncal writes it into a run's folder. Run the test "
            "again (python -m uncal.evaluate ckpt=…/best.ckpt) and give that run's folder."
        ) from error
    return frame


def _parsed(cells: pd.Series[str], known: bool) -> list[object]:
    """A column's cells as values; those of a column that is not ours stay text."""
    name = str(cells.name)
    bound = name.startswith(("lower_", "upper_"))
    kind = _KINDS.get(name, "number, not NaN" if bound else "number") if known else "text"
    values = []
    for line, cell in enumerate(cells, start=2):
        if not isinstance(cell, str) or not cell:
            raise ValueError(f"line {line} has no {name}")
        try:
            values.append(_PARSERS[kind.partition(",")[0]](cell))
            if kind.endswith("not NaN") and values[-1] != values[-1]:
                raise ValueError
        except (ValueError, KeyError):
            raise ValueError(f"line {line}: {name} is {cell!r}, expected {kind}") from None
    return values


def _check_complete(frame: pd.DataFrame, schema: Schema) -> None:
    if schema.complete is None:
        return
    keys = frame[list(schema.complete)].apply(tuple, axis=1) if schema.complete else frame["n"] * 0
    found = frame.groupby(keys.to_numpy(), sort=False)["dof"].agg(tuple)
    for key, dofs in found.items():
        if dofs != DOF_NAMES:
            parts = key if isinstance(key, tuple) else ("the table",)
            name = ", ".join(f"{p:g}%" if isinstance(p, float) else str(p) for p in parts)
            raise ValueError(
                f"{name} has rows for {', '.join(dofs)}, not for {', '.join(DOF_NAMES)}"
            )
