"""The tables of a comparison: the paper's rows with those of runs below, and what it lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from uncal.comparison.gathering import Gathered, Multirun
from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.frames import CONDITIONAL, CONTROL, CURVE, JOINT, Schema
from uncal.reporting.layout import length
from uncal.reporting.published import PublishedPaper
from uncal.reporting.published.paper import MCD_ALONE
from uncal.reporting.run import UNKNOWN, Run
from uncal.reporting.sections import (
    Section,
    conditional_section,
    control_section,
    curve_section,
    joint_section,
)

if TYPE_CHECKING:
    import pandas as pd

DOF_HEADINGS = [f"{dof} ({unit})" for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)]
METRICS = {"picp": "PICP (%)", "mpiw": "MPIW", "is": "IS"}

_TOO_SMALL = "∞: the uncertainty calibration set is too small for that level."


@dataclass(frozen=True)
class Table:
    """A table with what belongs under it.

    Attributes:
        title: what it shows.
        header: one cell per column.
        rows: the body; the first cell names the source.
        published: how many of the first rows are the paper's.
        texts: how many of the first columns are words and not numbers.
        groups: a heading above each column, "" where there is none; none at all if empty.
        notes: sentences to print below.
        origins: the commands that gave the rows of runs.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    published: int = 0
    texts: int = 2
    groups: Sequence[str] = ()
    notes: Sequence[str] = ()
    origins: Sequence[str] = ()

    def flat_header(self) -> list[str]:
        """The header in one line, for formats whose tables have no more."""
        groups = self.groups or [""] * len(self.header)
        return [f"{a} {b}".strip() for a, b in zip(groups, self.header, strict=True)]


def compared_table(paper: PublishedPaper, gathered: Gathered) -> Table:
    """Data, network, method, split, sizes and weights of everything shown."""
    rows = [
        [
            *(f"Paper, {each.data}", each.data, f"{each.network}; dropout {each.dropout}"),
            f"MC dropout + conformal, {paper.passes} passes; Table 2 (KITTI): MC dropout alone",
            *(each.split, UNKNOWN, UNKNOWN, "trained by its authors"),
        ]
        for each in paper.settings
    ]
    left_out = [
        f"{multirun.name} has {len(multirun.runs)} finished jobs: shown by its summary below, not "
        "one by one; report.csv has all. Give a job's own folder to see it in the tables."
        for multirun in gathered.multiruns
        if not multirun.shown
    ]
    return Table(
        "Data, networks, intervals, splits and weights",
        ["", "data", "network", "intervals", "split", "test / ucal frames", "seed", "weights"],
        [*rows, *map(_compared_row, gathered.runs)],
        published=len(rows),
        texts=8,
        notes=[
            f"Paper: {paper.source('Tables 1 and 2, sections 3.3, 4.1, 4.4')} ({paper.address}); "
            f"decalibration {paper.decalibration}.",
            "ucal: uncertainty calibration set. not recorded: the paper, or the run's folder, "
            "does not say.",
            *(f"{run.name}: {'; '.join(run.missing)}." for run in gathered.runs if run.missing),
            *left_out,
        ],
        origins=_origins(gathered.runs),
    )


def table_1(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """Coverage, width and interval score per DoF and level."""
    published = paper.table(1)
    levels = sorted({v.level for v in published} | {v for run in runs for v in run.per_dof.level})
    cells = [(dof, level) for dof in DOF_NAMES for level in levels]
    rows = []
    for data in dict.fromkeys(each.data for each in published):
        own = {(v.metric, v.dof, v.level): v.text for v in published if v.data == data}
        source = f"Paper, Table 1: {data}; {published[0].method}"
        for metric, name in METRICS.items():
            rows.append([source, name, *(own.get((metric, *cell), "–") for cell in cells)])
    count = len(rows)
    for run in runs:
        found = {(row["dof"], row["level"]): row for _, row in run.per_dof.iterrows()}
        for metric, name in METRICS.items():
            rows.append(
                [run.source, name, *(_interval_cell(run, found.get(c), metric) for c in cells)]
            )
    return Table(
        "Prediction intervals per DoF (the paper's Table 1)",
        ["source", "metric", *(f"{level:g}%" for _, level in cells)],
        rows,
        published=count,
        groups=["", "", *(heading for heading in DOF_HEADINGS for _ in levels)],
        notes=[
            "PICP: empirical coverage. MPIW: mean width of the intervals. IS: mean interval score. "
            "Widths and scores in cm or °, as printed in the paper, and of runs to 0.01 cm and "
            "0.001°.",
            f"Paper's rows: {paper.source('Table 1')}.",
            *paper.doubts,
            *_band_notes(runs),
        ],
        origins=_origins(runs),
    )


def table_2(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """Coverage of MC dropout alone, with normal quantiles; runs of other methods are left out."""
    published, alone = paper.table(2), [run for run in runs if run.method == MCD_ALONE]
    source = f"Paper, Table 2: {published[0].data}; {published[0].method}"
    rows = [
        [source, f"{level:g}%", *(v.text for v in published if v.level == level)]
        for level in dict.fromkeys(each.level for each in published)
    ]
    count = len(rows)
    for run in alone:
        for level, group in run.per_dof.groupby("level", sort=False):
            rows.append([run.source, f"{level:g}%", *(f"{v:.1f}" for v in group["picp"])])
    without = [
        "None of the runs has these intervals. python -m uncal.evaluate ckpt=…/best.ckpt "
        "interval=gaussian gives them from weights that are trained already."
    ]
    return Table(
        "MC dropout alone: empirical coverage, PICP in % (the paper's Table 2)",
        ["source", "nominal", *DOF_NAMES],
        rows,
        published=count,
        notes=[
            "Normal quantiles of σ, not calibrated: no coverage is guaranteed. Widths and scores "
            "of the same runs: Table 1 above, or, of the jobs of a large multirun, report.csv.",
            f"Paper's rows: {paper.source('Table 2')}.",
            *([] if alone else without),
        ],
        origins=_origins(alone),
    )


def point_errors(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """How far estimates are off: of one pass without dropout and of the mean over the passes."""
    blank = ["–"] * len(DOF_NAMES)
    rows = [
        [
            f"Paper, section 4.4: real KITTI, {each.source}",
            *("mean error", *blank, each.translation, each.rotation),
        ]
        for each in paper.errors
    ]
    count = len(rows)
    for run in runs:
        errors = run.per_dof.iloc[: len(DOF_NAMES)]
        lines = {
            "before (the decalibration)": _with_means(errors["mae_before"]),
            "after, mean of the passes": _with_means(errors["mae_after"]),
        }
        if CONTROL in run.tables:
            single = _with_means(run.tables[CONTROL]["mae_single"])
            lines["after, one pass without dropout"] = single
        if run.summary is not None:
            translation, rotation = run.summary.translation_after, run.summary.rotation_after
            whole = [length(translation, "cm"), length(rotation, "°")]
            lines["after, length and angle"] = [*blank, *whole]
        rows += [[run.source, name, *cells] for name, cells in lines.items()]
    return Table(
        "Errors of the estimate",
        ["source", "mean absolute error", *DOF_HEADINGS, "translation (cm)", "rotation (°)"],
        rows,
        published=count,
        notes=[
            "Translation and rotation: mean over the three axes; in the last line of a run the "
            "length and the angle of the whole error. The paper does not say which of the two its "
            "numbers are.",
            f"Paper's rows: {paper.source('section 4.4')}. Its claim is that MC dropout does not "
            "cost accuracy: for a run, that is the mean of the passes against one pass without "
            "dropout.",
            *_lacking(runs, CONTROL, " (one pass without dropout)"),
        ],
        origins=_origins(runs),
    )


def tables_beyond_the_paper(runs: Sequence[Run]) -> list[Table]:
    """The whole pose, the image-blind control, coverage by bins, calibration curves."""
    made = [
        _joint_table(runs),
        _of_sections(
            runs,
            CONTROL,
            lambda run, frame: control_section(frame),
            DOF_HEADINGS,
            "The paper has no such control.",
        ),
        _of_sections(runs, CONDITIONAL, lambda run, frame: conditional_section(frame), DOF_NAMES),
        _of_sections(
            runs,
            CURVE,
            lambda run, frame: curve_section(frame, run.guarantee),
            DOF_NAMES,
            "The paper shows its curves as figures, without numbers.",
        ),
    ]
    return [table for table in made if table is not None]


def multirun_tables(multirun: Multirun, sections: Sequence[Section]) -> list[Table]:
    """The sections of a multirun's summary."""
    return [
        Table(
            section.title,
            section.grid[0] if section.grid else [],
            section.grid[1:],
            texts=1,
            notes=[note.replace("`", "").strip() for note in section.notes],
            origins=[multirun.origin],
        )
        for section in sections
    ]


def _of_sections(
    runs: Sequence[Run],
    schema: Schema,
    section_of: Callable[[Run, pd.DataFrame], Section],
    headings: Sequence[str],
    *notes: str,
) -> Table | None:
    """The small tables that the runs' own reports have, with the run before each row."""
    sections = {
        run.name: section_of(run, run.tables[schema]) for run in runs if schema in run.tables
    }
    having = [run for run in runs if run.name in sections]
    if not having:
        return None
    notes_of: dict[str, list[str]] = {}
    for name, section in sections.items():
        for note in section.notes:
            notes_of.setdefault(note, []).append(name)
    return Table(
        " / ".join(dict.fromkeys(section.title for section in sections.values())),
        ["source", "", *headings],
        [[run.source, *line] for run in having for line in sections[run.name].grid[1:]],
        notes=[*by_name(notes_of, len(having)), *notes, *_lacking(runs, schema)],
        origins=_origins(having),
    )


def _joint_table(runs: Sequence[Run]) -> Table | None:
    """At the levels of all runs; a run has no numbers at those of others."""
    levels = sorted({v for run in runs if JOINT in run.tables for v in run.tables[JOINT]["level"]})

    def section(run: Run, frame: pd.DataFrame) -> Section:
        at_all = frame.set_index("level").reindex(levels).reset_index()
        return joint_section(at_all, run.guarantee)

    headings = [f"{level:g}%" for level in levels]
    return _of_sections(runs, JOINT, section, headings, "The paper reports no joint coverage.")


def by_name(names_of: Mapping[str, Sequence[str]], count: int) -> list[str]:
    """Sentences with the names of the runs that they are about, unless about all.

    >>> by_name({"Few frames.": ["Run 1"], "In cm.": ["Run 1", "Run 2"]}, 2)
    ['In cm.', 'Run 1: Few frames.']
    """
    everyone = [text for text, names in names_of.items() if len(names) == count]
    others = [f"{', '.join(n)}: {text}" for text, n in names_of.items() if len(n) < count]
    return everyone + others


def _origins(runs: Iterable[Run]) -> list[str]:
    return [run.origin for run in runs]


def _lacking(runs: Sequence[Run], schema: Schema, what: str = "") -> list[str]:
    """A sentence on the runs that a table must leave out."""
    without = [run.name for run in runs if schema not in run.tables]
    names = ", ".join(without)
    return [f"Not shown, since without {schema.file}{what}: {names}."] if without else []


def _compared_row(run: Run) -> list[str]:
    passes, split, sizes = run.setting("mcd.passes"), run.setting("split.by"), run.per_dof.iloc[0]
    return [
        f"{run.name} ({run.distinction})" if run.distinction else run.name,
        run.label,
        run.setting("model.name") or UNKNOWN,
        run.method + (f", {passes} passes" if passes else ""),
        f"by {split}" if split else UNKNOWN,
        f"{sizes['n_test']} / {sizes['n_calibration']}",
        run.entry("seed") or UNKNOWN,
        _weights_cell(run),
    ]


def _weights_cell(run: Run) -> str:
    """What was reused and what was computed."""
    weights = run.weights
    if not isinstance(weights.get("reused"), bool):
        return UNKNOWN
    name = weights.get("fingerprint") or weights.get("path") or "of a checkpoint"
    seconds = weights.get("training_seconds")
    took = f" ({seconds:.0f} s)" if isinstance(seconds, int | float) and seconds else ""
    origin = "reused, trained earlier" if weights["reused"] else "trained in this run"
    passes = "".join(f"; {split} passes {origin}" for split, origin in run.stored_passes.items())
    return f"{name}: {origin}{took}{passes}"


def _interval_cell(run: Run, row: pd.Series[float] | None, metric: str) -> str:
    if row is None:
        return "–"
    if metric == "picp":
        return f"{row['picp']:.1f}" + _mark(run, row["in_band"])
    return length(row[metric], str(row["unit"]))


def _mark(run: Run, in_band: object) -> str:
    return "" if in_band or run.guarantee != "exact" else "*"


def _with_means(values: pd.Series[float]) -> list[str]:
    """Six errors, then the mean over X, Y, Z and that over roll, pitch, yaw."""
    means = values.iloc[:3].mean(), values.iloc[3:].mean()
    both = zip([*values, *means], [*DOF_UNITS, "cm", "°"], strict=True)
    return [length(value, unit) for value, unit in both]


def _band_notes(runs: Sequence[Run]) -> list[str]:
    """The reference bands, and why a width is infinite."""
    exact = [run for run in runs if run.guarantee == "exact"]
    bands: dict[str, list[str]] = {}
    for run in exact:
        rows = run.per_dof[run.per_dof["dof"] == DOF_NAMES[0]]
        first = rows.iloc[0]
        ends = zip(rows["coverage_low"], rows["coverage_high"], rows["level"], strict=True)
        text = (
            f"reference band with {first['n_test']} test and {first['n_calibration']} uncertainty "
            "calibration frames: "
            + ", ".join(f"{low:.1f}-{high:.1f} at {level:g}%" for low, high, level in ends)
            + "."
        )
        bands.setdefault(text, []).append(run.name)
    notes = [f"{', '.join(names)}, {text}" for text, names in bands.items()]
    if exact:
        notes.append(
            "Reference band: where the Beta-Binomial law puts the coverage of one DoF with "
            f"probability {100 * BAND_CONFIDENCE:g}%, if the frames of both sets are exchangeable; "
            "frames of one rig or drive are not. The paper does not say how many frames it tested "
            "on."
        )
    if any(not all(run.per_dof["in_band"]) for run in exact):
        notes.append("*: outside the reference band.")
    if any(math.isinf(run.per_dof["mpiw"].max()) for run in runs):
        notes.append(_TOO_SMALL)
    return notes
