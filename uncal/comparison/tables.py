"""The tables of a comparison: the paper's rows with those of runs below, and what it lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import pandas as pd

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.folder import Multirun
from uncal.multirun.summary import summary_sections
from uncal.reporting import sections
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.frames import CONDITIONAL, CONTROL, CURVE, JOINT, Schema
from uncal.reporting.layout import length
from uncal.reporting.published.paper import MCD_ALONE, MCD_CP, PublishedPaper
from uncal.reporting.run import Run
from uncal.reporting.sections import DOF_HEADINGS, Section

METRICS = {"picp": "PICP (%)", "mpiw": "MPIW", "is": "IS"}

_TOO_SMALL = "∞: the uncertainty calibration set is too small for that level."


def table_1(paper: PublishedPaper, runs: Sequence[Run]) -> Section:
    """Coverage, width and interval score per DoF and level."""
    published = paper.table(1)
    levels = sorted({*published["level"], *(v for run in runs for v in run.per_dof["level"])})
    cells = [(dof, level) for dof in DOF_NAMES for level in levels]
    rows = []
    for data, own in published.groupby("data", sort=False):
        source = f"Paper, Table 1: {data}; {MCD_CP}"
        texts = own.pivot(index="metric", columns=["dof", "level"], values="text")
        shown_as = texts.reindex(columns=pd.MultiIndex.from_tuples(cells)).fillna("–")
        rows += [[source, name, *shown_as.loc[metric]] for metric, name in METRICS.items()]
    count = len(rows)
    for run in runs:
        found = {(row["dof"], row["level"]): row for _, row in run.per_dof.iterrows()}
        for metric, name in METRICS.items():
            texts = [_interval_cell(run, found.get(cell), metric) for cell in cells]
            rows.append([run.source, name, *texts])
    return Section(
        "Prediction intervals per DoF (the paper's Table 1)",
        [["source", "metric", *(f"{level:g}%" for _, level in cells)], *rows],
        published=count,
        texts=2,
        groups=["", "", *(heading for heading in DOF_HEADINGS for _ in levels)],
        notes=[
            "PICP: empirical coverage. MPIW: mean width of the intervals. IS: mean interval score. "
            "Widths and scores in cm or °, as printed in the paper, and of runs to 0.01 cm and "
            "0.001°.",
            f"Paper's rows: {paper.source('Table 1')}.",
            *paper.doubts,
            *_band_notes(runs),
        ],
        origins=[run.origin for run in runs],
    )


def table_2(paper: PublishedPaper, runs: Sequence[Run]) -> Section:
    """Coverage of MC dropout alone, with normal quantiles; runs of other methods are left out."""
    alone = [run for run in runs if run.method == MCD_ALONE]
    rows = [
        [f"Paper, Table 2: {data}; {MCD_ALONE}", f"{level:g}%", *own["text"]]
        for (data, level), own in paper.table(2).groupby(["data", "level"], sort=False)
    ]
    count = len(rows)
    for run in alone:
        for level, group in run.per_dof.groupby("level", sort=False):
            rows.append([run.source, f"{level:g}%", *sections.numbers(group["picp"], 1)])
    without = [
        "None of the runs has these intervals. python -m uncal.evaluate ckpt=…/best.ckpt "
        "interval=gaussian gives them from weights that are trained already."
    ]
    return Section(
        "MC dropout alone: empirical coverage, PICP in % (the paper's Table 2)",
        [["source", "nominal", *DOF_NAMES], *rows],
        published=count,
        texts=2,
        notes=[
            "Normal quantiles of σ, not calibrated: no coverage is guaranteed. Widths and scores "
            "of the same runs: Table 1 above, or, of the jobs of a large multirun, report.csv.",
            f"Paper's rows: {paper.source('Table 2')}.",
            *([] if alone else without),
        ],
        origins=[run.origin for run in alone],
    )


def point_errors(paper: PublishedPaper, runs: Sequence[Run]) -> Section:
    """How far estimates are off: of one pass without dropout and of the mean over the passes."""
    blank = ["–"] * len(DOF_NAMES)
    rows = [
        [f"Paper, section 4.4: real KITTI, {source}", "mean error", *blank, *texts]
        for source, texts in paper.errors.items()
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
    header = ["source", "mean absolute error", *DOF_HEADINGS, "translation (cm)", "rotation (°)"]
    return Section(
        "Errors of the estimate",
        [header, *rows],
        published=count,
        texts=2,
        notes=[
            "Translation and rotation: mean over the three axes; in the last line of a run the "
            "length and the angle of the whole error. The paper does not say which of the two its "
            "sections.numbers are.",
            f"Paper's rows: {paper.source('section 4.4')}. Its claim is that MC dropout does not "
            "cost accuracy: for a run, that is the mean of the passes against one pass without "
            "dropout.",
            *_lacking(runs, CONTROL, " (one pass without dropout)"),
        ],
        origins=[run.origin for run in runs],
    )


def tables_beyond_the_paper(runs: Sequence[Run]) -> list[Section]:
    """The whole pose, the image-blind control, coverage by bins, calibration curves."""
    # A run has no joint coverage at the levels of others.
    levels = sorted({v for run in runs if JOINT in run.tables for v in run.tables[JOINT]["level"]})

    def joint(run: Run, frame: pd.DataFrame) -> Section:
        at_all = frame.set_index("level").reindex(levels).reset_index()
        return sections.joint_section(at_all, run.guarantee)

    made = [
        _of_sections(runs, JOINT, joint, "The paper reports no joint coverage."),
        _of_sections(
            runs, CONTROL, lambda _, frame: sections.control_section(frame),
            "The paper has no such control.",
        ),
        _of_sections(runs, CONDITIONAL, lambda _, frame: sections.conditional_section(frame)),
        _of_sections(
            runs, CURVE, lambda run, frame: sections.curve_section(frame, run.guarantee),
            "The paper shows its curves as figures, without numbers.",
        ),
    ]  # fmt: skip
    return [table for table in made if table is not None]


def multirun_tables(multirun: Multirun) -> list[Section]:
    """The sections of a multirun's summary."""
    return [
        replace(
            section,
            notes=[note.replace("`", "").strip() for note in section.notes],
            origins=[multirun.origin],
        )
        for section in summary_sections(multirun)
    ]


def _of_sections(
    runs: Sequence[Run],
    schema: Schema,
    section_of: Callable[[Run, pd.DataFrame], Section],
    *notes: str,
) -> Section | None:
    """The small tables that the runs' own reports have, with the run before each row."""
    having = [run for run in runs if schema in run.tables]
    if not having:
        return None
    own = {run.name: section_of(run, run.tables[schema]) for run in having}
    notes_of: dict[str, list[str]] = {}
    for name, section in own.items():
        for note in section.notes:
            notes_of.setdefault(note, []).append(name)
    rows = [[run.source, *line] for run in having for line in own[run.name].grid[1:]]
    return Section(
        " / ".join(dict.fromkeys(section.title for section in own.values())),
        [["source", *own[having[0].name].grid[0]], *rows],
        texts=2,
        notes=[*by_name(notes_of, len(having)), *notes, *_lacking(runs, schema)],
        origins=[run.origin for run in having],
    )


def by_name(names_of: Mapping[str, Sequence[str]], count: int) -> list[str]:
    """Sentences with the names of the runs that they are about, unless about all.

    >>> by_name({"Few frames.": ["Run 1"], "In cm.": ["Run 1", "Run 2"]}, 2)
    ['In cm.', 'Run 1: Few frames.']
    """
    everyone = [text for text, names in names_of.items() if len(names) == count]
    others = [f"{', '.join(n)}: {text}" for text, n in names_of.items() if len(n) < count]
    return everyone + others


def _lacking(runs: Sequence[Run], schema: Schema, what: str = "") -> list[str]:
    """A sentence on the runs that a table must leave out."""
    without = [run.name for run in runs if schema not in run.tables]
    names = ", ".join(without)
    return [f"Not shown, since without {schema.file}{what}: {names}."] if without else []


def _interval_cell(run: Run, row: pd.Series[float] | None, metric: str) -> str:
    if row is None:
        return "–"
    if metric == "picp":
        return sections.marked(row["picp"], row["in_band"], run.guarantee == "exact")
    return length(row[metric], str(row["unit"]))


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
        notes.append(sections.OUTSIDE)
    if any(math.isinf(run.per_dof["mpiw"].max()) for run in runs):
        notes.append(_TOO_SMALL)
    return notes
