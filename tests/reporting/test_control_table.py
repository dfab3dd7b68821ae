from __future__ import annotations

import csv
import math
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats  # type: ignore[import-untyped]
from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.metrics.bootstrap import bootstrap_ratio
from uncal.models.split_prediction import ControlPrediction
from uncal.recordings.frame import FrameId
from uncal.reporting.control import blind_dofs, control_table, resampling_groups
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.frames import CONTROL
from uncal.reporting.measure import Results, measure
from uncal.reporting.report import TERMINAL_WIDTH, format_report, write_report
from uncal.reporting.sections import (
    contribution_cells,
    contribution_line,
    contribution_note,
    control_section,
)
from uncal.uncertainty import ConformalCalibrator

LEVELS = (0.8, 0.9)
REACH = torch.tensor([0.1] * 3 + [math.radians(1)] * 3)


def by_hand() -> ControlPrediction:
    """Frames of two rigs; X: 2 and 4 cm, left 1 and 1 cm, blind 2 and 4 cm. Z is never moved."""
    target = torch.tensor([[0.02] * 6, [-0.04] * 6])
    target[:, 2] = 0.0
    single = torch.tensor([[0.01] * 6, [-0.03] * 6])
    blind = torch.tensor([[0.0] * 6, [0.0] * 6])
    blind[:, 1] = single[:, 1]
    frames = (FrameId("a", "d", 0), FrameId("b", "d", 0))
    return ControlPrediction(torch.arange(2), frames, single, blind, target)


def predicted(n: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, σ and target: ±10 cm, ±1°, of which a third is left."""
    generator = torch.Generator().manual_seed(n)
    target = (2 * torch.rand(n, 6, generator=generator) - 1) * REACH
    std = REACH * (0.1 + 0.2 * torch.rand(n, 6, generator=generator))
    return target + std * torch.randn(n, 6, generator=generator), std, target


def control_of(target: Tensor, rigs: int = 20) -> ControlPrediction:
    """X and Y are estimated without the camera, the others with."""
    generator = torch.Generator().manual_seed(7)
    n = len(target)
    single = target + 0.2 * REACH * torch.randn(n, 6, generator=generator)
    blind = target + 0.6 * REACH * torch.randn(n, 6, generator=generator)
    blind[:, 0] = single[:, 0]
    blind[:, 1] = target[:, 1] + (single - target)[:, 1].flip(0)
    frames = tuple(FrameId(f"rig{i % rigs}", "drive", i) for i in range(n))
    return ControlPrediction(torch.arange(n), frames, single, blind, target)


def measured(with_control: bool = True) -> Results:
    calibrator = ConformalCalibrator(DOF_NAMES).fit(*predicted(400))
    mean, std, target = predicted(200)
    control = control_of(target) if with_control else None
    names = [f"rig/drive/{i:010d}" for i in range(200)] if with_control else None
    return measure(Evaluation(mean, std, target, calibrator), LEVELS, control=control, frames=names)


def test_rows_by_hand() -> None:
    rows = control_table(by_hand(), [0.5] * 6)
    assert rows["dof"].tolist() == list(DOF_NAMES)
    x, y, z, roll = (rows.iloc[j] for j in range(4))
    assert (x["unit"], x["n"], x["groups"], x["n_groups"], x["mae_mean"]) == (
        "cm",
        2,
        "rigs",
        2,
        0.5,
    )
    assert (x.mae_before, x.mae_single, x.mae_blind) == pytest.approx((3.0, 1.0, 3.0))
    assert x.contribution == pytest.approx(200 / 3)
    # Of both rigs, the first twice or the second twice: (1+3)/6, 1/2, 3/4.
    assert (x.contribution_low, x.contribution_high) == pytest.approx((50.0, 75.0))
    assert y.contribution == y.contribution_low == y.contribution_high == 0.0
    assert math.isnan(z.contribution)
    assert math.isnan(z.contribution_low)
    assert roll.mae_blind == pytest.approx(math.degrees(0.03))
    assert roll.contribution == pytest.approx(200 / 3)
    assert blind_dofs(rows) == ["Y"]


def test_the_interval_agrees_with_another_bootstrap_over_frames() -> None:
    random = np.random.default_rng(0)
    below = random.uniform(0, 1, (60, 1))
    above = 0.3 * below + random.normal(0, 0.2, (60, 1))
    low, high = bootstrap_ratio(above, below, [str(i) for i in range(60)])
    other = stats.bootstrap(
        (above[:, 0], below[:, 0]),
        lambda a, b, axis: a.mean(axis) / b.mean(axis),
        paired=True,
        vectorized=True,
        n_resamples=4000,
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    width = other.high - other.low
    assert low.item() == pytest.approx(other.low, abs=0.06 * width)
    assert high.item() == pytest.approx(other.high, abs=0.06 * width)


def test_whole_groups_are_drawn() -> None:
    # Unequal groups, one loop per resample with the same draws.
    random = np.random.default_rng(0)
    groups = [f"rig{i}" for i in random.integers(0, 7, 50)]
    above, below = random.normal(size=(50, 2)), random.uniform(1, 2, (50, 2))
    low, high = bootstrap_ratio(above, below, groups, resamples=300, seed=5)
    names = sorted(set(groups))
    ratios = []
    for draw in np.random.default_rng(5).integers(0, 7, (300, 7)):
        chosen = [i for each in draw for i, group in enumerate(groups) if group == names[each]]
        ratios.append(above[chosen].mean(0) / below[chosen].mean(0))
    np.testing.assert_allclose(low, np.percentile(ratios, 2.5, axis=0))
    np.testing.assert_allclose(high, np.percentile(ratios, 97.5, axis=0))


def test_frames_that_repeat_each_other_do_not_narrow_the_interval() -> None:
    random = np.random.default_rng(0)
    above, below = random.normal(1, 1, (12, 1)), np.ones((12, 1))
    rigs = [str(i) for i in range(12)]
    once = bootstrap_ratio(above, below, rigs)
    often = bootstrap_ratio(above.repeat(30, 0), below.repeat(30, 0), np.repeat(rigs, 30).tolist())
    np.testing.assert_allclose(often, once)
    alone = bootstrap_ratio(above.repeat(30, 0), below.repeat(30, 0), [str(i) for i in range(360)])
    assert alone[1] - alone[0] < 0.3 * (once[1] - once[0])


def test_the_same_twice_and_fast_for_many_frames() -> None:
    random = np.random.default_rng(0)
    above, below = random.normal(size=(5000, 6)), random.uniform(1, 2, (5000, 6))
    groups = [str(i) for i in range(5000)]
    start = time.process_time()
    first = bootstrap_ratio(above, below, groups)
    assert time.process_time() - start < 5
    np.testing.assert_array_equal(first, bootstrap_ratio(above, below, groups))


def test_the_coarsest_grouping_with_more_than_one_group() -> None:
    def kind(*names: str) -> str:
        pairs = (name.split("/") for name in names)
        return resampling_groups([FrameId(rig, drive, 0) for rig, drive in pairs])[0]

    assert kind("a/1", "b/1") == "rigs"
    assert kind("a/1", "a/2") == "drives"
    frames = [FrameId("a", "1", 0), FrameId("a", "1", 1)]
    assert resampling_groups(frames) == ("frames", ["a/1/0000000000", "a/1/0000000001"])


def test_cells_and_lines() -> None:
    rows = control_table(by_hand(), [0.5] * 6)
    assert contribution_cells(rows) == [
        "camera contributes (%)",
        *("66.7", "0.0", "–", "66.7", "66.7", "66.7"),
    ]
    assert contribution_line(rows).startswith(
        "Camera contributes (%, 95% interval): "
        "X 66.7 (50.0 to 75.0), Y 0.0 (0.0 to 0.0), Z – (– to –), Roll "
    )
    assert contribution_note(rows).endswith("Not shown to need the camera: Y.")
    assert "Not shown" not in contribution_note(rows[rows["dof"] != "Y"])


def test_the_section() -> None:
    section = control_section(control_table(by_hand(), [0.5] * 6))
    assert [line[1] for line in section.grid] == [
        "X (cm)", "3.00", "0.50", "1.00", "3.00", "66.7", "50.0 to 75.0",
    ]  # fmt: skip
    assert {len(line) for line in section.grid} == {7}
    notes = " ".join(section.notes)
    assert "95% bootstrap over 2 rigs; too few of them for more than an indication" in notes
    assert "Not shown to need the camera here: Y." in notes
    many = control_section(control_table(control_of(predicted(200)[2]), [0.5] * 6))
    assert "bootstrap over 20 rigs. 2000 resamples of 200 frames." in " ".join(many.notes)
    one_rig = control_section(control_table(control_of(predicted(200)[2], rigs=1), [0.5] * 6))
    assert "over 200 frames of one drive, which are dependent" in " ".join(one_rig.notes)


def test_a_row_of_every_evaluation(tmp_path: Path) -> None:
    results = measured()
    assert results.control is not None
    # The same frames, hence the very numbers of results.csv.
    first = results.per_dof.iloc[:6]
    assert results.control["mae_before"].tolist() == pytest.approx(
        first["mae_before"].tolist(), rel=1e-12
    )
    assert results.control["mae_mean"].tolist() == first["mae_after"].tolist()
    assert blind_dofs(results.control) == ["X", "Y"]
    paths = write_report(tmp_path, results, label="simulated")
    assert [path.name for path in paths[-2:]] == ["control.csv", "predictions.csv"]
    with paths[-2].open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == list(CONTROL.columns)
    for (_, row), cells in zip(results.control.iterrows(), read, strict=True):
        assert float(cells["contribution_low"]) == row["contribution_low"]
        assert (cells["dof"], int(cells["n"]), cells["groups"]) == (row["dof"], 200, "rigs")
    markdown = paths[1].read_text(encoding="utf-8")
    table = [line for line in markdown.splitlines() if line.startswith("|")]
    assert table[4].startswith("| after / before |")
    assert table[5].startswith("| camera contributes (%) | 0.0 | ")
    assert "## What the camera contributes: the image-blind control" in markdown
    terminal = format_report(results, label="simulated")
    lines = terminal.splitlines()
    after = next(i for i, line in enumerate(lines) if line.startswith("after / before"))
    assert lines[after + 1].startswith("camera contributes (%) ")
    assert lines[after + 2] == ""
    assert max(map(len, lines)) <= TERMINAL_WIDTH
    assert "Camera contributes (%, 95% interval): X 0.0 (0.0 to 0.0), Y " in terminal
    assert "nan" not in markdown + terminal


def test_no_control_no_row_and_no_file_of_an_earlier_run(tmp_path: Path) -> None:
    write_report(tmp_path, measured(), label="simulated")
    results = measured(with_control=False)
    paths = write_report(tmp_path, results, label="simulated")
    assert len(paths) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(p.name for p in paths)
    for text in (paths[1].read_text(encoding="utf-8"), format_report(results, label="simulated")):
        assert "amera contributes" not in text
