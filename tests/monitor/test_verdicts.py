"""What the monitor says of estimates, sensors and streams, without a network."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from scipy.stats import binom  # type: ignore[import-untyped]

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.adaptive import make_quantiles
from uncal.monitor.decision import Interval, decide
from uncal.monitor.martingale import ExchangeabilityMartingale
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.statistics import SensorCheck
from uncal.monitor.view import bar
from uncal.recordings.frame import Frame, FrameId
from uncal.uncertainty import ConformalCalibrator

SETTINGS = MonitorSettings.shipped()
SIGMA = np.array([0.005] * 3 + [math.radians(0.05)] * 3)


def said(
    correction: Sequence[float], sigma: float = 1.0, doubts: list[str] | None = None
) -> tuple[str, str]:
    interval = Interval.around(np.array(correction), sigma * SIGMA, np.array([2.0] * 6 + [3.0]))
    return decide(interval, SETTINGS.limits, interval, SETTINGS.drift, doubts or [], 8, 8)


@pytest.mark.parametrize(
    ("correction", "sigma", "verdict", "word"),
    [
        ([0.01, 0, 0, 0, 0, 0], 1.0, "ok", "holds zero"),
        ([0.018, 0, 0, 0, 0, 0], 1.0, "ok", "next to it"),
        ([0, 0.03, 0, 0, 0, 0], 1.0, "drifting", "Y is off by 3.0 cm"),
        ([0, 0, 0, 0, math.radians(-0.9), 0], 1.0, "recalibrate", "Pitch is off by -0.90°"),
        ([0, 0, 0, 0, 0, 0], 12.0, "recalibrate", "wide"),
    ],
)
def test_verdicts(correction: list[float], sigma: float, verdict: str, word: str) -> None:
    found, reason = said(correction, sigma)
    assert found == verdict
    assert word in reason


def test_a_drift_is_one_before_the_window_is_full() -> None:
    interval = Interval.around(
        np.array([0.07, 0, 0, 0, 0, 0]), 12 * SIGMA * [0.1, 1, 1, 1, 1, 1], np.full(7, 2.0)
    )
    found = [
        decide(interval, SETTINGS.limits, interval, SETTINGS.drift, [], frames, 8)[0]
        for frames in (2, 8)
    ]
    assert found == ["drifting", "recalibrate"]


def test_doubts_come_first() -> None:
    assert said([1.0] * 6, doubts=["the camera is dark"]) == ("untrusted", "the camera is dark")


def frame(index: int, image: int | None = None, n: int = 4000) -> Frame:
    rng = np.random.default_rng(index)
    shown = rng.integers(0, 256, (32, 64, 3), dtype=np.uint8)
    if image is not None:
        shown = np.full_like(shown, image)
    points = rng.uniform(-20, 20, (n, 4)).astype(np.float32)
    return Frame(FrameId("rig", "drive", index), shown, points, np.eye(3), np.eye(4), 0.0)


def test_sensors_that_give_nothing_are_named() -> None:
    check = SensorCheck(SETTINGS.sensors)
    assert check.fault(frame(0)) is None
    assert "the camera is dark" in str(check.fault(frame(1, image=0)))
    assert "the image shows nothing" in str(check.fault(frame(2, image=90)))
    assert "10 LiDAR points, fewer than 1000" in str(check.fault(frame(3, n=10)))
    assert check.fault(frame(4)) is None
    again = check.fault(frame(4))
    assert "the LiDAR is frozen" in str(again)
    assert "the camera is frozen" in str(again)
    assert check.fault(frame(5)) is None


def test_false_alarms_are_as_rare_as_villes_bound_says() -> None:
    rng = np.random.default_rng(0)
    runs, rate = 400, 0.1
    alarms = 0
    for run in range(runs):
        values = rng.standard_normal((30 + 40, 3))
        martingale = ExchangeabilityMartingale(values[:30], period=40, seed=run)
        alarms += max(martingale.feed(row) for row in values[30:]) >= 1 / rate
    assert alarms <= binom.ppf(0.999, runs, rate)


def test_a_change_is_noticed() -> None:
    rng = np.random.default_rng(1)
    martingale = ExchangeabilityMartingale(rng.standard_normal((100, 3)), period=60, seed=0)
    before = [martingale.feed(row) for row in rng.standard_normal((10, 3))]
    assert max(before) < 100
    changed = rng.standard_normal((50, 3)) + np.array([0.0, 4.0, 0.0])
    wealth = [martingale.feed(row) for row in changed]
    assert max(wealth) >= 100
    assert martingale.oddest == 1


def calibrator() -> ConformalCalibrator:
    rng = torch.Generator().manual_seed(0)
    error = torch.randn(200, 6, generator=rng).double()
    return ConformalCalibrator(DOF_NAMES).fit(error, torch.ones_like(error), torch.zeros(200, 6))


@pytest.mark.parametrize("adapt", ["aci", "pid"])
def test_references_bring_coverage_back(adapt: str) -> None:
    quantiles = make_quantiles(adapt, [calibrator()], 0.9)
    plain = make_quantiles("off", [calibrator()], 0.9)
    rng = np.random.default_rng(2)
    covered, left_alone = [], []
    for _ in range(1500):
        scores = np.abs(2.0 * rng.standard_normal(6))  # twice what σ says
        scores = np.append(scores, scores.max())
        covered.append(scores <= quantiles.of(1))
        left_alone.append(scores <= plain.of(1))
        quantiles.observe(1, scores)
        plain.observe(1, scores)
    late = np.mean(covered[500:], 0)
    assert np.mean(left_alone, 0).max() < 0.75
    # Gibbs & Candès, Proposition 4.1: within (max(α₁, 1-α₁) + γ) / (γ T) of 0.9, for any stream.
    assert np.abs(late - 0.9).max() < 0.05
    again = make_quantiles(adapt, [calibrator()], 0.9)
    again.load(quantiles.state())
    np.testing.assert_array_equal(again.of(1), quantiles.of(1))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"level": 1.0}, "level=1.0"),
        ({"window": 0}, "window=0"),
        ({"adapt": "yes"}, "adapt=yes"),
        ({"limits": {"width_cm": -1.0}}, "limits.width_cm=-1.0"),
        ({"limit": 3}, "limit: no setting"),
    ],
)
def test_settings_out_of_range_are_named(changes: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigurationError, match=named.replace(".", r"\.")):
        MonitorSettings.shipped(**changes)


def test_bars_are_readable() -> None:
    assert bar(-2.0, 2.0, 2.0).count("━") == 30
    assert bar(1.0, 2.0, 2.0)[15] == "│"
    assert set(bar(5.0, 6.0, 2.0)) == {"·", "│"}
