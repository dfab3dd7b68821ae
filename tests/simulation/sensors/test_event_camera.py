from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.simulation.sensors.event_camera import (
    EventCamera,
    SensorEvents,
    crossings,
    merge,
    shot_noise,
)
from uncal.simulation.settings import EventSettings

PLAIN = {
    "window_ms": 50.0,
    "subframes": 4,
    "threshold_on": 0.2,
    "threshold_off": 0.2,
    "threshold_mismatch": 0.0,
    "refractory_us": 0.0,
    "noise_hz": 0.0,
    "dark": 1e-4,
    "distortion": 0.0,
    "yaw_rate_deg_s": 0.0,
    "sway_rate_deg_s": 0.0,
}


def camera(size: tuple[int, int], **changes: float) -> EventCamera:
    settings = EventSettings.from_mapping({**PLAIN, **changes})
    return EventCamera(settings, size, np.random.default_rng(0))


def one_pixel(
    light: list[float],
    times: list[int],
    reference: float = 0.0,
    on: float = 0.25,
    off: float = 0.25,
    refractory_us: float = 0.0,
) -> list[tuple[int, bool]]:
    """Times and polarities of a single pixel's events."""
    past, rise, fall = (np.full((1, 1), value) for value in (reference, on, off))
    images = np.array(light).reshape(-1, 1, 1)
    found = crossings(images, np.array(times), past, rise, fall, refractory_us)
    return list(zip(found.t.tolist(), found.p.tolist(), strict=True))


def net_count(events: SensorEvents, size: tuple[int, int]) -> NDArray[np.float64]:
    """ON less OFF events of each pixel."""
    counts = np.zeros(size)
    np.add.at(counts, (events.y, events.x), np.where(events.p, 1, -1))
    return counts


def test_a_ramp_crosses_at_even_times() -> None:
    # 1 per 1000 µs from 0 on, 0.25 each: at 250, 500, 750; at 1000 the window has ended.
    assert one_pixel([0.0, 1.0], [0, 1000]) == [(250, True), (500, True), (750, True), (999, True)]
    # Steeper by two and downwards, threshold 0.5, on a clock that does not begin at 0.
    falling = one_pixel([0.0, -2.0], [7000, 8000], off=0.5)
    assert falling == [(7250, False), (7500, False), (7750, False), (7999, False)]


def test_the_reference_is_remembered_across_sub_frames_and_turns() -> None:
    # Up to 0.4: one event at 0.25. Back to 0.1: 0.25 - 0.25 = 0 is not reached. To 0.5: at 0.5.
    light, times = [0.0, 0.4, 0.1, 0.5], [0, 400, 700, 1100]
    assert one_pixel(light, times) == [(250, True), (1099, True)]
    # Down to -0.2 instead: 0 is crossed 250 µs after the turn at 400 µs + 150 µs.
    assert one_pixel([0.0, 0.4, -0.2], [0, 400, 1000]) == [(250, True), (800, False)]


def test_a_pixel_that_has_seen_light_before_fires_earlier() -> None:
    assert one_pixel([0.0, 0.2], [0, 200], reference=-0.15) == [(100, True)]
    assert one_pixel([0.0, 0.2], [0, 200], reference=0.15) == []


def test_thresholds_of_both_polarities_are_kept_apart() -> None:
    assert len(one_pixel([0.0, 1.01], [0, 1000], on=0.1, off=0.5)) == 10
    assert len(one_pixel([0.0, -1.01], [0, 1000], on=0.1, off=0.5)) == 2


@pytest.mark.parametrize(
    ("refractory_us", "expected"),
    [(0, [100, 200, 300, 400, 500]), (100, [100, 200, 300, 400, 500]), (101, [100, 300, 500])],
)
def test_refractory_pixels_are_silent(refractory_us: float, expected: list[int]) -> None:
    # Sub-frames in between must not make a difference: the dead time runs on across them.
    for light, times in (([0.0, 1.125], [0, 563]), ([0.0, 0.5, 1.125], [0, 250, 563])):
        found = one_pixel(light, times, on=0.2, refractory_us=refractory_us)
        assert [t for t, _ in found] == pytest.approx(expected, abs=1)


def test_constant_light_gives_no_events() -> None:
    light = np.full((4, 3, 5), 0.7)
    none = crossings(light, np.arange(4), light[0], light[0], light[0], 0.0)
    assert len(none) == 0
    assert none.x.dtype == np.uint16
    assert none.t.dtype == np.int64


def test_a_moving_edge_gives_events_on_its_way_with_its_sign() -> None:
    # Bright on the left, moving right over columns 4 to 7: these get brighter, one by one.
    columns = np.arange(12)
    for sign in (1, -1):
        images = [sign * np.tile((columns <= 3 + k).astype(float), (2, 1)) for k in range(5)]
        light, level = np.stack(images), np.full((2, 12), 0.5)
        found = crossings(light, 1000 * np.arange(5), light[0], level, level, 0.0)
        assert set(found.x.tolist()) == {4, 5, 6, 7}
        assert set(found.y.tolist()) == {0, 1}
        assert (found.p == (sign > 0)).all()
        assert (np.diff(found.t) >= 0).all()
        for column in range(4, 8):
            passing = found.t[found.x == column] // 1000
            assert set(passing.tolist()) <= {column - 4, column - 3}


def test_events_follow_the_gradient_and_the_motion() -> None:
    """A translating pattern: dL/dt = -flow · gradient, so do the events and their signs."""
    size, flow = (60, 80), np.array([2.0, -1.5])
    y, x = np.mgrid[: size[0], : size[1]].astype(float)

    def pattern(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        wave = np.sin(0.35 * x + 0.1 * y) + np.cos(0.2 * x - 0.3 * y)
        return np.asarray(np.exp(wave), np.float64)

    shares = np.linspace(0, 1, 5)
    images = [pattern(x - flow[0] * share, y - flow[1] * share) for share in shares]
    light = np.stack(images).astype(np.float32)
    events = camera(size, threshold_on=0.05, threshold_off=0.05).watch(
        light, (50_000 * shares).astype(np.int64), np.random.default_rng(1)
    )
    along_y, along_x = np.gradient(np.log(images[2]))
    expected = -(flow[0] * along_x + flow[1] * along_y)
    counted = net_count(events, size)
    assert np.corrcoef(expected.ravel(), counted.ravel())[0, 1] > 0.97
    clear = np.abs(expected) > 0.15
    assert clear.mean() > 0.5
    assert (np.sign(counted[clear]) == np.sign(expected[clear])).mean() > 0.99
    wrong_way = flow[0] * along_x - flow[1] * along_y
    assert abs(np.corrcoef(wrong_way.ravel(), counted.ravel())[0, 1]) < 0.9


def test_pixels_differ_by_the_mismatch() -> None:
    sensor = camera((200, 200), threshold_mismatch=0.1, threshold_on=0.2, threshold_off=0.4)
    for values, nominal in ((sensor.on, 0.2), (sensor.off, 0.4)):
        logs = np.log(values / nominal)
        assert logs.std() == pytest.approx(0.1, rel=0.05)
        assert abs(logs.mean()) < 0.1 / 200 * 4
    assert abs(np.corrcoef(sensor.on.ravel(), sensor.off.ravel())[0, 1]) < 0.05
    equal = camera((3, 4))
    assert (equal.on == 0.2).all()


def test_small_changes_are_reported_by_a_share_of_the_pixels() -> None:
    # A pixel's memory lies evenly within ±0.2, so a change of 0.1 reaches a threshold in 1 of 4.
    size = (100, 100)
    light = np.exp(np.stack([np.zeros(size), np.full(size, 0.1)])).astype(np.float32)
    events = camera(size).watch(light, np.array([0, 1000]), np.random.default_rng(0))
    assert len(events) / 10_000 == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / 1e4))
    assert events.p.all()


def test_dark_pixels_are_slower() -> None:
    # Twice the light is a change of log 2 in the bright half, and of nearly nothing in the dark.
    light = np.ones((2, 20, 20), np.float32)
    light[:, :10] = 1e-5
    light[1] *= 2
    events = camera((20, 20), dark=0.01).watch(light, np.array([0, 1000]), np.random.default_rng(0))
    assert (events.y >= 10).all()
    assert len(events) > 400


def test_noise_has_its_rate_and_no_favourite_pixel() -> None:
    noise = shot_noise(20.0, (40, 50), 1_000_000, 1_500_000, np.random.default_rng(0))
    expected = 20.0 * 40 * 50 * 0.5
    assert len(noise) == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert noise.p.mean() == pytest.approx(0.5, abs=0.02)
    assert (noise.x.max(), noise.y.max()) == (49, 39)
    assert 1_000_000 <= noise.t.min() <= noise.t.max() < 1_500_000
    assert (np.diff(noise.t) >= 0).all()
    still = np.ones((3, 40, 50), np.float32)
    events = camera((40, 50), noise_hz=20.0).watch(
        still, np.array([0, 1000, 500_000]), np.random.default_rng(0)
    )
    assert len(events) == pytest.approx(expected, abs=4 * np.sqrt(expected))


def test_merging_keeps_order_and_rows_together() -> None:
    first = SensorEvents(
        *(np.array([1, 2], np.uint16),) * 2, np.array([5, 9]), np.array([1, 1]) > 0
    )
    second = SensorEvents(*(np.array([3], np.uint16),) * 2, np.array([7]), np.array([0]) > 0)
    both = merge([first, second])
    assert both.t.tolist() == [5, 7, 9]
    assert both.x.tolist() == both.y.tolist() == [1, 3, 2]
    assert both.p.tolist() == [True, False, True]
