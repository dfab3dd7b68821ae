"""The torchmetrics of boxes, curves and bins against the functions that they wrap."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torchmetrics import MetricCollection

from uncal.metrics import (
    CalibrationCurve,
    CalibrationCurveError,
    CoverageByBin,
    CoverageByQuantileBin,
    GeometricMeanWidth,
    JointPICP,
    MeanLogVolume,
    RelativeSize,
    WorstBinCoverage,
)
from uncal.metrics.calibration_curve import calibration_curve, calibration_error
from uncal.metrics.conditional import coverage_by_bin, worst_bin_coverage
from uncal.metrics.functional import covered
from uncal.metrics.joint import geometric_mean_width, joint_picp, mean_log_volume, relative_size

PARTS = (slice(0, 7), slice(7, 8), slice(8, 50))


def _intervals() -> tuple[Tensor, Tensor, Tensor]:
    lower = torch.randn(50, 6)
    return lower, lower + 3 * torch.rand(50, 6), torch.randn(50, 6)


def test_boxes_accumulate_to_the_functions() -> None:
    lower, upper, target = _intervals()
    boxes = MetricCollection([JointPICP(), MeanLogVolume(6), GeometricMeanWidth(6)])
    relative = RelativeSize(6)
    for part in PARTS:
        boxes.update(lower[part], upper[part], target[part])
        relative.update(lower[part], upper[part], lower[part] - 1, upper[part])
    found = boxes.compute()
    torch.testing.assert_close(found["JointPICP"], joint_picp(lower, upper, target))
    torch.testing.assert_close(found["MeanLogVolume"], mean_log_volume(lower, upper))
    torch.testing.assert_close(found["GeometricMeanWidth"], geometric_mean_width(lower, upper))
    expected = relative_size(lower, upper, lower - 1, upper)
    torch.testing.assert_close(relative.compute(), expected)
    assert expected < 1


def test_an_infinite_box_in_one_batch_and_a_flat_one_in_another() -> None:
    zeros, ones, infinite = torch.zeros(2, 3), torch.ones(2, 3), torch.full((2, 3), torch.inf)
    metric, relative = GeometricMeanWidth(3), RelativeSize(3)
    for upper in (zeros, infinite, ones):
        metric.update(zeros, upper, zeros)
        relative.update(zeros, ones, zeros, upper)
    assert metric.compute().item() == torch.inf
    assert relative.compute().item() == 0.0
    metric.reset()
    metric.update(zeros, ones, zeros)
    assert metric.compute().item() == 1.0


def test_curves_accumulate_to_the_functions() -> None:
    levels = (0.5, 0.9)
    lower, upper, target = _intervals()
    low, high = torch.stack([lower, lower - 1]), torch.stack([upper, upper + torch.inf])
    curve, error = CalibrationCurve(6, levels), CalibrationCurveError(6, levels)
    signed = CalibrationCurveError(6, levels, signed=True)
    for part in PARTS:
        for metric in (curve, error, signed):
            metric.update(low[:, part], high[:, part], target[part])
    expected = calibration_curve(low, high, target)
    torch.testing.assert_close(curve.compute(), expected)
    torch.testing.assert_close(error.compute(), calibration_error(expected, levels).absolute)
    torch.testing.assert_close(signed.compute(), calibration_error(expected, levels).signed)


def test_bins_accumulate_to_the_functions() -> None:
    lower, upper, target = _intervals()
    sigma, edges = torch.rand(50, 6), torch.tensor([0.3, 0.6])
    fixed, quantiles, worst = (
        CoverageByBin(6, edges),
        CoverageByQuantileBin(6, bins=3),
        WorstBinCoverage(6, bins=3),
    )
    for part in PARTS:
        for metric in (fixed, quantiles, worst):
            metric.update(lower[part], upper[part], target[part], sigma[part])
    inside = covered(lower, upper, target)
    for metric, bins in ((fixed, edges), (quantiles, 3)):
        for found, expected in zip(
            metric.compute(), coverage_by_bin(inside, sigma, bins), strict=True
        ):
            torch.testing.assert_close(found, expected, equal_nan=True)
    expected = worst_bin_coverage(coverage_by_bin(inside, sigma, 3))
    torch.testing.assert_close(worst.compute(), expected)


def test_forward_gives_the_batch_and_keeps_the_whole() -> None:
    lower, upper, target = _intervals()
    metric = CoverageByBin(6, torch.tensor([0.5]))
    values = torch.linspace(0, 1, 50)
    batch = metric(lower[:10], upper[:10], target[:10], values[:10])
    assert batch.counts.tolist() == [[10] * 6, [0] * 6]
    metric(lower[10:], upper[10:], target[10:], values[10:])
    assert metric.compute().counts.tolist() == [[25] * 6] * 2


def test_refusals() -> None:
    lower, upper, target = _intervals()
    with pytest.raises(ValueError, match=r"expected \(n, 3\)"):
        MeanLogVolume(3).update(lower, upper, target)
    with pytest.raises(ValueError, match=r"\(50, 6\), \(4, 6\)"):
        RelativeSize(6).update(lower, upper, lower[:4], upper[:4])
    with pytest.raises(ValueError, match=r"expected \(2, n, 6\)"):
        CalibrationCurve(6, [0.5, 0.9]).update(lower[None], upper[None], target)
    with pytest.raises(ValueError, match="levels"):
        CalibrationCurve(6, [90.0])
    for metric in (CoverageByBin(3, torch.tensor([0.5])), CoverageByQuantileBin(3, 2)):
        with pytest.raises(ValueError, match=r"expected \(n, 3\)"):
            metric.update(lower, upper, target, target)
    for make in (MeanLogVolume, lambda n: CalibrationCurve(n, [0.9])):
        with pytest.raises(ValueError, match="num_outputs = 0"):
            make(0)
    with pytest.raises(ValueError, match="bins = 0"):
        CoverageByQuantileBin(6, bins=0)
