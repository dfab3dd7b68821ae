"""What stands beside what: the notice, and a table of who made which numbers."""

from __future__ import annotations

from uncal.reporting.comparison.gathering import Gathered, Multirun
from uncal.reporting.comparison.record import UNKNOWN
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.table import Table, made_by
from uncal.reporting.published import PublishedPaper

NOTICE_TITLE = (
    "Theirs on real KITTI and DSEC, ours on what each run used: not comparable as accuracy"
)


def notice(gathered: Gathered) -> list[str]:
    """What a reader must know before any number, one paragraph each.

    Args:
        gathered: the runs.
    """
    runs = [f"{run.name}: {run.label}" for run in gathered.single]
    for multirun in gathered.multiruns:
        labels = dict.fromkeys(run.label for run in multirun.runs)
        runs.append(f"{multirun.name} (a multirun): {', '.join(labels)}")
    return [
        "The paper's numbers: real KITTI and real DSEC recordings, its authors' networks, weights "
        "and splits.",
        f"The runs' numbers: {'; '.join(runs)}; with the networks named below.",
        "Errors, widths and interval scores from different data and networks cannot be ranked. "
        "What can be compared is the kind of statement: whether intervals hold as often as was "
        "asked of them, which DoF are harder than others, and what happens without conformal "
        "prediction.",
    ]


def compared_table(paper: PublishedPaper, gathered: Gathered) -> Table:
    """Data, network, method, split, sizes and weights of everything shown.

    Args:
        paper: with its settings.
        gathered: the runs.
    """
    passes = f"{paper.passes} passes"
    rows = [
        [
            f"Paper, {each.data}",
            each.data,
            f"{each.network}; dropout {each.dropout}",
            f"MC dropout + conformal, {passes}; Table 2 (KITTI): MC dropout alone",
            each.split,
            UNKNOWN,
            UNKNOWN,
            "trained by its authors",
        ]
        for each in paper.settings
    ]
    count = len(rows)
    rows += [_row(run) for run in gathered.runs]
    missing = {run.name: run.missing for run in gathered.runs if run.missing}
    return Table(
        "Data, networks, intervals, splits and weights",
        ["", "data", "network", "intervals", "split", "test / ucal frames", "seed", "weights"],
        rows,
        published=count,
        texts=8,
        notes=[
            f"Paper: {paper.source('Tables 1 and 2, sections 3.3, 4.1, 4.4')} ({paper.address}); "
            f"decalibration {paper.decalibration}.",
            "ucal: uncertainty calibration set. not recorded: the paper, or the run's folder, "
            "does not say.",
            *(f"{name}: {'; '.join(sentences)}." for name, sentences in missing.items()),
            *(_left_out(multirun) for multirun in gathered.multiruns if not multirun.shown),
        ],
        made_by=made_by(gathered.runs),
    )


def _left_out(multirun: Multirun) -> str:
    return (
        f"{multirun.name} has {len(multirun.runs)} finished jobs: shown by its summary below, not "
        "one by one; report.csv has all. Give a job's own folder to see it in the tables."
    )


def _row(run: Run) -> list[str]:
    record, first = run.record, run.rows[0]
    passes = f", {record.passes} passes" if record.passes else ""
    return [
        f"{run.name} ({run.told_by})" if run.told_by else run.name,
        run.label,
        record.network or UNKNOWN,
        f"{record.method}{passes}",
        f"by {record.split}" if record.split else UNKNOWN,
        f"{first.n_test} / {first.n_calibration}",
        record.seed or UNKNOWN,
        _weights(run),
    ]


def _weights(run: Run) -> str:
    """What was reused and what was computed."""
    record = run.record
    if record.reused is None:
        return UNKNOWN
    name = record.fingerprint or record.weights_path or "of a checkpoint"
    took = f" ({record.training_seconds:.0f} s)" if record.training_seconds else ""
    origin = f"reused, trained earlier{took}" if record.reused else f"trained in this run{took}"
    passes = "".join(f"; {split} passes {how}" for split, how in record.stored_passes.items())
    return f"{name}: {origin}{passes}"
