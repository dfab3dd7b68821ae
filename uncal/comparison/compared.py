"""What a comparison compares: data, networks, intervals, splits, sizes and weights."""

from __future__ import annotations

from uncal.comparison.gathering import Gathered, shown
from uncal.reporting.published.paper import PublishedPaper
from uncal.reporting.run import UNKNOWN, Run
from uncal.reporting.sections import Section


def compared_table(paper: PublishedPaper, gathered: Gathered) -> Section:
    """Data, network, method, split, sizes and weights of everything shown."""
    rows = [
        [
            *(f"Paper, {data}", data, f"{about['network']}; dropout {about['dropout']}"),
            f"MC dropout + conformal, {paper.passes} passes; Table 2 (KITTI): MC dropout alone",
            *(about["split"], UNKNOWN, UNKNOWN, "trained by its authors"),
        ]
        for data, about in paper.settings.items()
    ]
    left_out = [
        f"{multirun.name} has {len(multirun.runs)} finished jobs: shown by its summary below, not "
        "one by one; report.csv has all. Give a job's own folder to see it in the tables."
        for multirun in gathered.multiruns
        if not shown(multirun)
    ]
    header = ["", "data", "network", "intervals", "split", "test / ucal frames", "seed", "weights"]
    return Section(
        "Data, networks, intervals, splits and weights",
        [header, *rows, *map(_compared_row, gathered.runs)],
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
        origins=[run.origin for run in gathered.runs],
    )


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
    stored = run.mapping("passes").items()  # whether stochastic passes were computed or reused
    passes = "".join(f"; {split.replace('_', ' ')} passes {source}" for split, source in stored)
    return f"{name}: {origin}{took}{passes}"
