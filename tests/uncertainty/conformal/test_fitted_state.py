from __future__ import annotations

import pytest
import torch
from torch import nn

from uncal.uncertainty import (
    AbsoluteCalibrator,
    ConformalCalibrator,
    MondrianCalibrator,
    PredictorIdentity,
    PredictorMismatchError,
)

IDENTITY = PredictorIdentity("ab" * 32, 25, (0.25, 0.05))
FIXED = PredictorIdentity("ab" * 32, 25, (0.25, 0.05), masks="3f2a9c11d2e4b5f6")


def _fitted(identity: PredictorIdentity | None = IDENTITY) -> ConformalCalibrator:
    target = torch.arange(1.0, 41.0).reshape(20, 2)
    zeros = torch.zeros(20, 2)
    return ConformalCalibrator().fit(zeros, zeros + 1, target, identity=identity)


def test_a_state_replaces_a_newer_fit_in_a_parent() -> None:
    parent = nn.ModuleDict({"calibrator": _fitted(FIXED)})
    state = _fitted().state_dict()
    parent.load_state_dict({f"calibrator.{name}": value for name, value in state.items()})
    calibrator = parent["calibrator"]
    assert isinstance(calibrator, ConformalCalibrator)
    assert calibrator.identity == IDENTITY
    assert calibrator.fit(torch.zeros(9, 2), torch.ones(9, 2), torch.ones(9, 2)).is_fitted
    assert len(calibrator.joint_scores) == 9


def test_a_state_without_a_calibrator_is_still_missing() -> None:
    with pytest.raises(RuntimeError, match="Missing key"):
        nn.ModuleDict({"calibrator": ConformalCalibrator()}).load_state_dict({})


@pytest.mark.parametrize("strict", [True, False])
def test_another_kind_of_calibrator_is_refused(strict: bool) -> None:
    other = AbsoluteCalibrator()
    message = r'state of a "conformal" calibrator, and this one is "absolute": build the kind'
    with pytest.raises(RuntimeError, match=message):
        other.load_state_dict(_fitted().state_dict(), strict=strict)
    with pytest.raises(RuntimeError, match='is "mondrian"'):
        MondrianCalibrator().load_state_dict(_fitted().state_dict(), strict=strict)
    assert not other.is_fitted


def test_a_subclass_without_a_kind_of_its_own_takes_over_the_state() -> None:
    class Louder(ConformalCalibrator):
        pass

    louder = Louder()
    louder.load_state_dict(_fitted().state_dict())
    assert louder.is_fitted


def test_masks_are_part_of_the_identity() -> None:
    calibrator = _fitted(FIXED)
    calibrator.check_matches(FIXED)
    assert calibrator.identity == FIXED
    with pytest.raises(
        PredictorMismatchError, match=r"masks: fixed \(3f2a9c11d2e4…\) then, random"
    ):
        calibrator.check_matches(IDENTITY)
    with pytest.raises(PredictorMismatchError, match=r"random then, fixed \(3f2a9c11d2e4…\) now"):
        _fitted(IDENTITY).check_matches(FIXED)


def test_fit_without_identity_forgets_the_one_before() -> None:
    calibrator = _fitted(FIXED)
    calibrator.fit(torch.zeros(3, 2), torch.ones(3, 2), torch.ones(3, 2))
    assert calibrator.identity is None
    assert calibrator.masks_digest.numel() == 0
