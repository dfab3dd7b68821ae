from __future__ import annotations

import pytest
import torch

from uncal.metrics.functional import calibration_error

LEVELS = [0.25, 0.5, 0.75]


def test_by_hand() -> None:
    observed = torch.tensor([[0.25, 0.5], [0.25, 0.5], [0.75, 1.0]])
    error = calibration_error(observed, LEVELS)
    assert error.absolute.tolist() == pytest.approx([0.25 / 3, 0.5 / 3])
    assert error.signed.tolist() == pytest.approx([-0.25 / 3, 0.5 / 3])


def test_refusals() -> None:
    curve = torch.full((3, 2), 0.5)
    with pytest.raises(ValueError, match="for 2 levels"):
        calibration_error(curve, [0.5, 0.9])
    for levels in ([], [0.5, 0.9, 1.0]):
        with pytest.raises(ValueError, match="expected at least one"):
            calibration_error(curve, levels)
