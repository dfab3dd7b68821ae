import pytest
import torch
from scipy.stats import kstest  # type: ignore[import-untyped]

from uncal.errors import ConfigurationError
from uncal.geometry import pose_to_matrix
from uncal.geometry.decalibration import DecalibrationRange, correct, decalibrate

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)


def test_bounds_are_metres_and_radians() -> None:
    expected = torch.tensor([0.1, 0.1, 0.1] + [torch.pi / 180] * 3)
    torch.testing.assert_close(RANGE.bounds, expected)


def test_draws_are_uniform_over_the_range_on_every_axis() -> None:
    torch.manual_seed(0)
    fixed = torch.stack([RANGE.draw_for(3, str(i)) for i in range(2000)])
    for draws in (RANGE.draw(2000), fixed):
        unit = (draws / RANGE.bounds + 1) / 2
        for axis in range(6):
            assert kstest(unit[:, axis].numpy(), "uniform").pvalue > 1e-3


def test_a_fixed_draw_does_not_depend_on_the_state_of_any_generator() -> None:
    torch.manual_seed(1)
    first = RANGE.draw_for(7, "rig/drive/0000000000")
    torch.manual_seed(2)
    RANGE.draw(5)
    assert torch.equal(first, RANGE.draw_for(7, "rig/drive/0000000000"))


def test_a_fixed_draw_is_the_same_on_every_machine() -> None:
    # Written down once: a change would silently change every published test set.
    expected = torch.tensor([-0.792389, -0.649778, -0.065598, 0.787735, -0.00418, -0.500288])
    torch.testing.assert_close(RANGE.draw_for(0, "a") / RANGE.bounds, expected, atol=1e-6, rtol=0.0)


def test_correcting_with_the_truth_restores_the_extrinsic() -> None:
    torch.manual_seed(0)
    T = pose_to_matrix(torch.randn(8, 6))
    draws = RANGE.draw(8)
    wrong = decalibrate(T, draws)
    assert (wrong - T).abs().amax((1, 2)).min() > 1e-3
    torch.testing.assert_close(correct(wrong, draws), T, atol=1e-5, rtol=0.0)


def test_a_decalibration_moves_the_lidar_in_its_own_frame() -> None:
    # Camera looks along the LiDAR's x axis: one metre forward is one metre of depth.
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    moved = decalibrate(T, torch.tensor([1.0, 0, 0, 0, 0, 0]))
    assert moved[:3, 3].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("rotation", "translation", "key"),
    [(0.0, 10.0, "rotation_deg"), (1.0, -1.0, "translation_cm"), (float("nan"), 1.0, "rotation")],
)
def test_a_bad_range_is_refused_by_name(rotation: float, translation: float, key: str) -> None:
    with pytest.raises(ConfigurationError, match=key):
        DecalibrationRange(rotation, translation)
