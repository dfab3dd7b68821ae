from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.metrics.pose_error import pose_errors
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.frames import RESULTS
from uncal.reporting.measure import Results, measure
from uncal.reporting.report import TERMINAL_WIDTH, format_report, write_report
from uncal.reporting.sections import main_grid
from uncal.uncertainty import ConformalCalibrator, NotCalibratedError, coverage_band

LEVELS = (0.9, 0.95, 0.99)


def _predictions(n: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, σ and target: ±10 cm, ±1°, of which a third is left."""
    generator = torch.Generator().manual_seed(seed)
    reach = torch.tensor([0.1] * 3 + [math.radians(1)] * 3)
    target = (2 * torch.rand(n, 6, generator=generator) - 1) * reach
    std = reach * (0.1 + 0.2 * torch.rand(n, 6, generator=generator))
    return target + std * torch.randn(n, 6, generator=generator), std, target


def _results(m: int) -> Results:
    calibrator = ConformalCalibrator(DOF_NAMES).fit(*_predictions(m, seed=1))
    return measure(Evaluation(*_predictions(200), calibrator), LEVELS)


def test_a_table_by_hand() -> None:
    # Scores 1…9: the 90% quantile is 9. With σ = 1 mm, or 1 mrad, the intervals are ±9 of them.
    zeros, milli = torch.zeros(9, 6), torch.full((9, 6), 1e-3)
    scores = torch.arange(1.0, 10.0)[:, None].expand(9, 6)
    calibrator = ConformalCalibrator().fit(zeros, milli, 1e-3 * scores)
    target = torch.tensor([[0.02] * 6, [-0.04] * 6])
    mean = torch.tensor([[0.015] * 6, [-0.02] * 6])  # errors of 5 (inside) and 20 (outside)
    rows = measure(Evaluation(mean, milli[:2], target, calibrator), [0.9]).per_dof
    assert rows["dof"].tolist() == list(DOF_NAMES)
    x, yaw = rows.iloc[0], rows.iloc[5]
    assert (x.unit, x.level, x.picp, x.n_test, x.n_calibration) == ("cm", 90.0, 50.0, 2, 9)
    assert x.mae_before == pytest.approx(3.0)
    assert x.mae_after == pytest.approx(1.25)
    assert x.ratio == pytest.approx(1.25 / 3)
    assert x.mpiw == pytest.approx(1.8)
    assert x["is"] == pytest.approx(1.8 + 20 * 1.1 / 2, rel=1e-5)
    assert yaw.unit == "°"
    assert yaw.mpiw == pytest.approx(math.degrees(0.018))
    assert yaw.mae_before == pytest.approx(math.degrees(0.03))
    low, high = coverage_band(2, 9, 0.1)
    assert (x.coverage_low, x.coverage_high) == (100 * low, 100 * high)


def test_coverage_is_inside_the_band_and_a_wrong_calibrator_is_not() -> None:
    rows = _results(m=300).per_dof
    assert len(rows) == 18
    assert rows["in_band"].all()
    inside = rows["picp"].between(rows["coverage_low"], rows["coverage_high"])
    assert rows["in_band"].tolist() == inside.tolist()
    mean, std, target = _predictions(300, seed=1)
    overconfident = ConformalCalibrator().fit(mean, 4 * std, target)
    mean, std, target = _predictions(200)
    assert not measure(Evaluation(mean, std, target, overconfident), [0.9]).per_dof["in_band"].any()


def test_pose_errors_by_hand() -> None:
    target = torch.tensor([[0.03, 0.04, 0.0, 0.0, 0.0, 0.02], [0.0, 0.0, 0.1, 0.0, 0.01, 0.0]])
    summary = pose_errors(torch.zeros(2, 6), target, n_calibration=7)
    assert summary.translation_before == summary.translation_after == pytest.approx(7.5)
    assert summary.rotation_before == pytest.approx(math.degrees(0.015))
    assert summary.rotation_after == pytest.approx(math.degrees(0.015))
    assert summary.mean_ratio == pytest.approx(1.0)
    perfect = pose_errors(target, target, n_calibration=7)
    assert perfect.translation_after == 0.0
    assert perfect.rotation_after == pytest.approx(0.0, abs=1e-6)
    assert perfect.mean_ratio == 0.0


def test_rotation_error_is_the_angle_between_the_rotations() -> None:
    # Yaw by 30° on top of roll by 20°: cos θ = (trace - 1)/2 of Rz(30°) Rx(20°).
    target = torch.zeros(1, 6)
    target[0, 3], target[0, 5] = math.radians(20), math.radians(30)
    c, r = math.cos(math.radians(30)), math.cos(math.radians(20))
    angle = math.degrees(math.acos((c + c * r + r - 1) / 2))
    assert pose_errors(torch.zeros(1, 6), target, 1).rotation_before == pytest.approx(
        angle, rel=1e-6
    )


def test_a_dof_that_was_never_decalibrated_has_no_ratio() -> None:
    mean, std, target = _predictions(50)
    target[:, 2] = 0.0
    calibrator = ConformalCalibrator().fit(*_predictions(100, seed=1))
    results = measure(Evaluation(mean, std, target, calibrator), [0.9])
    ratios = results.per_dof["ratio"].tolist()
    assert math.isnan(ratios.pop(2))
    others = ratios
    assert results.summary.mean_ratio == pytest.approx(sum(others) / 5)
    assert "–" in format_report(results, label="simulated")


def test_csv_reads_back_exactly(tmp_path: Path) -> None:
    results = _results(m=300)
    table, *_ = write_report(tmp_path / "run", results, label="simulated")
    assert table.name == "results.csv"
    with table.open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == list(RESULTS.columns)
    for (_, row), line in zip(results.per_dof.iterrows(), read, strict=True):
        assert (line["dof"], line["unit"]) == (row["dof"], row["unit"])
        for column in ("level", "picp", "mpiw", "is", "mae_before", "mae_after", "ratio"):
            assert float(line[column]) == row[column]
        assert line["in_band"] == str(row["in_band"])
        assert int(line["n_test"]) == 200


def test_same_predictions_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_report(tmp_path / name, _results(m=150), label="simulated", notes=["A note."])
    for file in ("results.csv", "results.md"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_nothing_but_its_files_is_left(tmp_path: Path) -> None:
    for _ in range(2):
        paths = write_report(tmp_path, _results(m=150), label="simulated")
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_markdown(tmp_path: Path) -> None:
    results = _results(m=300)
    _, text, *_ = write_report(tmp_path, results, label="simulated", notes=["By rig."])
    lines = text.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# Results on simulated data"
    assert "| X (cm) | Y (cm) | Z (cm) | Roll (°) | Pitch (°) | Yaw (°) |" in lines[4]
    mpiw = results.per_dof["mpiw"][0]
    main = lines[: lines.index("## The whole pose")]
    assert len([line for line in main if line.startswith("|")]) == 2 + 3 + 3 * 3
    assert f"| 90% MPIW | {mpiw:.2f} |" in "\n".join(lines)
    assert "- By rig." in lines


@pytest.mark.filterwarnings("ignore:40 samples")
def test_infinite_widths(tmp_path: Path) -> None:
    results = _results(m=40)
    table, text, *_ = write_report(tmp_path, results, label="KITTI")
    assert "X,cm,99.0,100.0,inf,inf,100.0,100.0,True," in table.read_text(encoding="utf-8")
    for shown in (text.read_text(encoding="utf-8"), format_report(results, label="KITTI")):
        assert "∞" in shown
        assert "inf" not in shown
        assert "nan" not in shown
        assert "too few for a 99% interval; it needs 99" in " ".join(shown.split())


def test_terminal_is_aligned_and_fits() -> None:
    results = _results(m=300)
    text = format_report(results, label="simulated", notes=["word " * 60, "By rig."])
    lines = text.splitlines()
    assert max(len(line) for line in lines) <= TERMINAL_WIDTH
    table = lines[
        4 : 4 + len(main_grid(results.per_dof, None, exact=True)) + 3
    ]  # a gap before each level
    assert len({len(line) for line in table if line}) == 1
    assert table[-1].startswith("99% IS")
    assert "By rig." in lines


def test_out_of_band_is_marked() -> None:
    mean, std, target = _predictions(300, seed=1)
    calibrator = ConformalCalibrator().fit(mean, 4 * std, target)
    mean, std, target = _predictions(200)
    results = measure(Evaluation(mean, std, target, calibrator), [0.9])
    text = format_report(results, label="simulated")
    assert f"{results.per_dof['picp'][0]:.1f}*" in text
    assert "*: outside the reference band." in text


def test_refusals() -> None:
    mean, std, target = _predictions(10)
    calibrator = ConformalCalibrator().fit(*_predictions(100, seed=1))
    with pytest.raises(NotCalibratedError):
        measure(Evaluation(mean, std, target, ConformalCalibrator()), LEVELS)
    with pytest.raises(ValueError, match=r"must be \(n, 6\)"):
        measure(Evaluation(mean[:, :5], std, target, calibrator), LEVELS)
    with pytest.raises(ValueError, match="no coverage levels"):
        measure(Evaluation(mean, std, target, calibrator), [])
    target[0, 0] = torch.nan
    with pytest.raises(ValueError, match="1 values that are NaN"):
        pose_errors(mean, target, 100)
