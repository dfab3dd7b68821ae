from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.frames import CONDITIONAL, CURVE, JOINT, RESULTS
from uncal.reporting.measure import Results, measure
from uncal.reporting.report import TERMINAL_WIDTH, format_report, write_report
from uncal.uncertainty import (
    ConformalCalibrator,
    GaussianIntervals,
    HierarchicalCalibrator,
    MondrianCalibrator,
    QuantileCalibrator,
    UncertaintyError,
)

LEVELS = (0.8, 0.9)


def _predictions(n: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, σ and target: ±10 cm, ±1°, of which a third is left."""
    generator = torch.Generator().manual_seed(seed)
    reach = torch.tensor([0.1] * 3 + [math.radians(1)] * 3)
    target = (2 * torch.rand(n, 6, generator=generator) - 1) * reach
    std = reach * (0.1 + 0.2 * torch.rand(n, 6, generator=generator))
    return target + std * torch.randn(n, 6, generator=generator), std, target


def _measured() -> Results:
    calibrator = ConformalCalibrator(DOF_NAMES).fit(*_predictions(400, seed=1))
    return measure(Evaluation(*_predictions(200, seed=0), calibrator), LEVELS)


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_all_files(tmp_path: Path) -> None:
    results = _measured()
    paths = write_report(tmp_path / "run", results, label="simulated", notes=["By rig."])
    names = ["results.csv", "results.md", "joint.csv", "conditional.csv", "calibration_curve.csv"]
    assert [path.name for path in paths] == names
    assert sorted(each.name for each in paths[0].parent.iterdir()) == sorted(names)
    assert list(_read(paths[0])[0]) == list(RESULTS.columns)
    for path, schema, rows in (
        (paths[2], JOINT, results.joint),
        (paths[3], CONDITIONAL, results.conditional),
        (paths[4], CURVE, results.curve),
    ):
        read = _read(path)
        assert list(read[0]) == list(schema.columns)
        assert len(read) == len(rows)
    first = _read(paths[2])[0]
    assert float(first["joint"]) == results.joint["joint"][0]
    assert float(first["bonferroni_size"]) == results.joint["bonferroni_size"][0]
    assert float(_read(paths[3])[-1]["value_to"]) == results.conditional["value_to"].iloc[-1]
    text = paths[1].read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## The whole pose",
        "## Coverage of the 80% intervals by σ and by size of the decalibration",
        "## Calibration curve, 5% to 95%",
    ]
    assert "- By rig." in text
    assert "nan" not in text


def test_same_predictions_same_bytes(tmp_path: Path) -> None:
    pairs = zip(
        write_report(tmp_path / "a", _measured(), label="simulated"),
        write_report(tmp_path / "b", _measured(), label="simulated"),
        strict=True,
    )
    assert all(a.read_bytes() == b.read_bytes() for a, b in pairs)


def test_independent_errors_are_held_together_less_often() -> None:
    results = _measured()
    for _, row in results.joint.iterrows():
        # Six independent errors: (1-α)^6 is .26 and .53.
        assert row.together == pytest.approx(100 * (row.level / 100) ** 6, abs=12)
        assert row.joint_in_band
        assert row.joint > row.together + 20
        assert row.bonferroni >= row.level - 5


def test_terminal_has_the_whole_pose_and_fits() -> None:
    text = format_report(_measured(), label="simulated", notes=["word " * 60])
    assert max(len(line) for line in text.splitlines()) <= TERMINAL_WIDTH
    assert "The whole pose" in text
    assert "Joint box (%)" in text
    assert "reference band" in text


def test_a_method_that_promises_nothing_is_allowed_nothing(tmp_path: Path) -> None:
    calibrator = GaussianIntervals(DOF_NAMES).fit(*_predictions(400, seed=1))
    mean, std, target = _predictions(200, seed=0)
    results = measure(Evaluation(mean, std / 4, target, calibrator), LEVELS)
    assert results.guarantee == "none"
    assert not results.per_dof["in_band"].any()
    paths = write_report(tmp_path, results, label="simulated")
    for text in (paths[1].read_text(encoding="utf-8"), format_report(results, label="simulated")):
        assert "This interval method guarantees no coverage." in text
        assert "90% PICP (%)" in text
        assert "Reference band:" not in text
        assert ", reference band" not in text
        assert "*" not in text
    assert list(_read(paths[0])[0]) == list(RESULTS.columns)


def test_groups_and_bounds_reach_the_calibrator(tmp_path: Path) -> None:
    fitted, tested = _predictions(400, seed=1), _predictions(200, seed=0)
    groups = ["a", "b"] * 200
    mondrian = MondrianCalibrator(DOF_NAMES).fit(*fitted, groups=groups)
    results = measure(Evaluation(*tested, mondrian, groups=groups[:200]), LEVELS)
    assert results.guarantee == "by group"
    paths = write_report(tmp_path, results, label="simulated")
    assert "guarantees coverage by group" in paths[1].read_text(encoding="utf-8")
    with pytest.raises(UncertaintyError, match="groups"):
        measure(Evaluation(*tested, mondrian), LEVELS)
    with pytest.raises(ValueError, match="3 groups for 200 samples"):
        measure(Evaluation(*tested, mondrian, groups=["a"] * 3), LEVELS)

    def bounds(data: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        return data[0] - data[1], data[0] + data[1]

    quantile = QuantileCalibrator(DOF_NAMES).fit(*fitted, bounds=bounds(fitted))
    rows = measure(Evaluation(*tested, quantile, bounds=bounds(tested)), LEVELS).per_dof
    assert rows["in_band"].all()
    with pytest.raises(UncertaintyError, match="bounds"):
        measure(Evaluation(*tested, quantile), LEVELS)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_too_few_groups_are_infinite_and_said_to_be(tmp_path: Path) -> None:
    calibrator = HierarchicalCalibrator(DOF_NAMES).fit(
        *_predictions(40, seed=1), groups=["a", "b", "c", "d"] * 10
    )
    results = measure(Evaluation(*_predictions(20, seed=0), calibrator, groups=["e"] * 20), [0.9])
    assert results.per_dof["mpiw"].map(math.isinf).all()
    text = write_report(tmp_path, results, label="simulated")[1].read_text(encoding="utf-8")
    assert "∞: too few groups" in text
    assert "nan" not in text
    assert "inf" not in text
