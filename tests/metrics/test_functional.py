from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from crepes import ConformalRegressor  # type: ignore[import-untyped]
from mapie.metrics.regression import (  # type: ignore[import-untyped]
    regression_coverage_score,
    regression_mean_width_score,
    regression_mwi_score,
)
from torch import Tensor

from uncal.metrics.functional import covered, interval_score, mpiw, picp, score, width

INF = torch.inf


def test_by_hand() -> None:
    # X: [0, 1] misses by 0.5 below, holds, misses by 0.25 above, holds at the edge.
    # Y: [-1, 3] holds all.
    lower = torch.tensor([[0.0, -1.0]]).expand(4, 2)
    upper = torch.tensor([[1.0, 3.0]]).expand(4, 2)
    target = torch.tensor([[-0.5, 0.0], [0.3, 3.0], [1.25, -1.0], [1.0, 1.0]])
    assert picp(lower, upper, target).tolist() == [0.5, 1.0]
    assert mpiw(lower, upper).tolist() == [1.0, 4.0]
    # 1 + 2/0.5 · (0.5 + 0.25)/4 = 1.75
    assert interval_score(lower, upper, target, alpha=0.5).tolist() == [1.75, 4.0]
    assert covered(lower, upper, target).tolist() == [[False, True], [True, True]] * 2
    assert width(lower, upper)[0].tolist() == [1.0, 4.0]
    assert score(lower, upper, target, alpha=0.5)[:, 0].tolist() == [3.0, 1.0, 2.0, 1.0]


@pytest.mark.parametrize("level", [0.8, 0.9, 0.99])
def test_against_mapie(level: float) -> None:
    rng = np.random.default_rng(0)
    target = rng.standard_t(3, 500)
    lower = rng.normal(size=500) - 1.0
    upper = lower + rng.exponential(2.0, 500)
    low, high, truth = (torch.from_numpy(values) for values in (lower, upper, target))
    pairs = np.stack([lower, upper], axis=1)[:, :, None]
    assert picp(low, high, truth).item() == pytest.approx(
        regression_coverage_score(target, pairs).item()
    )
    assert mpiw(low, high).item() == pytest.approx(regression_mean_width_score(pairs).item())
    assert interval_score(low, high, truth, alpha=1 - level).item() == pytest.approx(
        regression_mwi_score(target, pairs, level), rel=1e-12
    )


def test_against_crepes() -> None:
    # Each library judges the intervals that crepes makes: coverage and mean width.
    rng = np.random.default_rng(1)
    sigma, estimate = rng.exponential(1.0, 400) + 0.1, rng.normal(size=400)
    target = estimate + sigma * rng.standard_t(3, 400)
    regressor = ConformalRegressor().fit((target - estimate)[:200], sigmas=sigma[:200])
    test = {"sigmas": sigma[200:], "confidence": 0.85}
    judged = regressor.evaluate(estimate[200:], target[200:], metrics=["error", "eff_mean"], **test)
    pairs = torch.from_numpy(regressor.predict_int(estimate[200:], **test))
    lower, upper = pairs.unbind(1)
    found = picp(lower, upper, torch.from_numpy(target[200:])).item()
    assert found == pytest.approx(1 - judged["error"])
    assert 0.7 < found < 1
    assert mpiw(lower, upper).item() == pytest.approx(judged["eff_mean"])


def test_infinite_intervals_cover_and_cost_infinitely() -> None:
    lower, upper = torch.full((3, 2), -INF), torch.full((3, 2), INF)
    target = torch.randn(3, 2)
    assert picp(lower, upper, target).tolist() == [1.0, 1.0]
    assert mpiw(lower, upper).tolist() == [INF, INF]
    assert interval_score(lower, upper, target, alpha=0.1).tolist() == [INF, INF]


@pytest.mark.parametrize(("lower", "upper"), [(-INF, 0.0), (0.0, INF)])
def test_one_sided_intervals_that_miss(lower: float, upper: float) -> None:
    target = torch.tensor([5.0 if upper == 0.0 else -5.0])
    bounds = torch.tensor([lower]), torch.tensor([upper])
    assert picp(*bounds, target).item() == 0.0
    assert interval_score(*bounds, target, alpha=0.1).item() == INF


def test_infinity_stays_in_its_output() -> None:
    lower = torch.tensor([[-INF, 0.0], [0.0, 0.0]])
    assert mpiw(lower, torch.ones(2, 2)).tolist() == [INF, 1.0]


def test_half_precision_is_computed_in_float32() -> None:
    bounds = torch.zeros(300, 1, dtype=torch.bfloat16), torch.ones(300, 1, dtype=torch.bfloat16)
    target = torch.zeros(300, 1, dtype=torch.bfloat16)
    target[:1] = 2.0
    assert picp(*bounds, target).item() == pytest.approx(299 / 300, abs=1e-6)
    assert interval_score(*bounds, target, alpha=0.1).dtype == torch.float32


Metric = Callable[[Tensor, Tensor, Tensor], Tensor]
ALL: list[Metric] = [
    picp,
    lambda lower, upper, _: mpiw(lower, upper),
    lambda lower, upper, target: interval_score(lower, upper, target, 0.1),
]


@pytest.mark.parametrize("metric", ALL)
def test_refusals(metric: Metric) -> None:
    zeros, ones = torch.zeros(3, 2), torch.ones(3, 2)
    with pytest.raises(ValueError, match=r"lower \(3, 2\) and upper \(2, 2\)"):
        metric(zeros, ones[:2], zeros)
    with pytest.raises(ValueError, match="at least one sample"):
        metric(zeros[:0], ones[:0], zeros[:0])
    with pytest.raises(ValueError, match="1 of 6 values of upper are NaN"):
        metric(zeros, _with(ones, torch.nan), zeros)
    with pytest.raises(ValueError, match="1 of 6 intervals are empty"):
        metric(_with(zeros, 2.0), ones, zeros)
    with pytest.raises(ValueError, match="1 of 6 intervals are empty"):
        metric(_with(zeros, INF), _with(ones, INF), zeros)


@pytest.mark.parametrize("metric", [ALL[0], ALL[2]])
def test_refused_targets(metric: Metric) -> None:
    zeros, ones = torch.zeros(3, 2), torch.ones(3, 2)
    with pytest.raises(ValueError, match=r"target \(3,\)"):
        metric(zeros, ones, zeros[:, 0])
    for bad in (torch.nan, INF):
        with pytest.raises(ValueError, match="1 of 6 values of target"):
            metric(zeros, ones, _with(zeros, bad))


@pytest.mark.parametrize("alpha", [0.0, 1.0, 10.0, torch.nan])
def test_refused_alpha(alpha: float) -> None:
    with pytest.raises(ValueError, match="outside"):
        interval_score(torch.zeros(1), torch.ones(1), torch.zeros(1), alpha)


def _with(values: Tensor, first: float) -> Tensor:
    changed = values.clone()
    changed[0, 0] = first
    return changed
