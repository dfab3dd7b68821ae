from __future__ import annotations

import pytest
import torch

from uncal.metrics.calibration_curve import calibration_curve, calibration_error
from uncal.metrics.functional import picp

LEVELS = [0.25, 0.5, 0.75]


def test_by_hand() -> None:
    # Errors 1, 2, 3, 4; half-widths 1, 1, 3 at the three levels; the second output twice as wide.
    target = torch.arange(1.0, 5.0)[:, None].expand(4, 2)
    half = torch.tensor([1.0, 1.0, 3.0])[:, None, None] * torch.tensor([1.0, 2.0])
    half = half.expand(3, 4, 2)
    observed = calibration_curve(-half, half, target)
    assert observed.tolist() == [[0.25, 0.5], [0.25, 0.5], [0.75, 1.0]]
    error = calibration_error(observed, LEVELS)
    assert error.absolute.tolist() == pytest.approx([0.25 / 3, 0.5 / 3])
    assert error.signed.tolist() == pytest.approx([-0.25 / 3, 0.5 / 3])


def test_a_level_is_the_picp_of_its_intervals() -> None:
    lower, target = torch.randn(3, 40, 6), torch.randn(40, 6)
    upper = lower + 2 * torch.rand(3, 40, 6)
    expected = torch.stack([picp(*bounds, target) for bounds in zip(lower, upper, strict=True)])
    torch.testing.assert_close(calibration_curve(lower, upper, target), expected)


def test_infinite_intervals_cover() -> None:
    bound = torch.full((1, 5, 2), torch.inf)
    observed = calibration_curve(-bound, bound, torch.randn(5, 2))
    assert observed.tolist() == [[1.0, 1.0]]
    assert calibration_error(observed, [0.9]).signed.tolist() == pytest.approx([0.1, 0.1])


def test_refusals() -> None:
    lower, target = torch.zeros(3, 4, 2), torch.zeros(4, 2)
    with pytest.raises(ValueError, match=r"expected \(L, n, D\)"):
        calibration_curve(lower[0], lower[0] + 1, target)
    with pytest.raises(ValueError, match="NaN"):
        calibration_curve(lower, lower * torch.nan, target)
    curve = torch.full((3, 2), 0.5)
    with pytest.raises(ValueError, match="for 2 levels"):
        calibration_error(curve, [0.5, 0.9])
    for levels in ([], [0.5, 0.9, 1.0]):
        with pytest.raises(ValueError, match="expected at least one"):
            calibration_error(curve, levels)
