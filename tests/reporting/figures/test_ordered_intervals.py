from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.figures.predictions import (
    POINTS,
    bounds,
    covered,
    moving_average,
    ordered_intervals,
    smoothing_window,
)

TRUTH = (3.0, -1.0, 2.0, 0.0)


def _rows(levels: dict[float, float]) -> pd.DataFrame:
    """Estimates 1 above the truth, and half widths per level."""
    rows = [
        {"frame": f"{i}", "dof": dof, "unit": unit, "truth": truth, "estimate": truth + 1}
        | {f"lower_{level:g}": truth + 1 - half for level, half in levels.items()}
        | {f"upper_{level:g}": truth + 1 + half for level, half in levels.items()}
        for i, truth in enumerate(TRUTH)
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
    ]
    frame: pd.DataFrame = pd.DataFrame(rows)
    return frame


def _corners(panel: Axes, k: int) -> set[tuple[float, float]]:
    paths = panel.collections[k].get_paths()
    return {(float(x), float(y)) for path in paths for x, y in np.asarray(path.vertices)}


def _predictions(n: int) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    truth, width = rng.uniform(-10, 10, n), rng.uniform(1, 5, n)
    values = {"truth": truth, "estimate": truth}
    values |= {"lower_90": truth - width, "upper_90": truth + width}
    parts = [
        pd.DataFrame({"dof": dof, "unit": unit} | values)
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
    ]
    frame: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return frame


def test_bounds_and_coverage_of_a_dof() -> None:
    rows = _rows({90.0: 3.0, 50.0: 0.5})
    pitch = rows[rows["dof"] == "Pitch"]
    assert bounds(pitch, 90.0)[0].tolist() == [1.0, -3.0, 0.0, -2.0]
    assert covered(pitch, 90.0).all()
    assert not covered(pitch, 50.0).any()


def test_regions_are_bounds_minus_truth_in_the_order_of_truth() -> None:
    rows = _rows({90.0: 3.0, 95.0: 4.0})
    # Narrower at the frame with the smallest truth, so that a wrong order would show.
    rows.loc[(rows["dof"] == "X") & (rows["frame"] == "1"), "lower_90"] = -1.5
    panel = ordered_intervals(rows, "simulated").figure.axes[0]
    assert _corners(panel, 0) >= {(1, -0.5), (2, -2), (4, -2), (1, 4), (4, 4)}
    assert (1, -2) not in _corners(panel, 0)
    assert _corners(panel, 1) >= {(1, -3), (4, -3), (1, 5), (4, 5)}
    estimate, zero = panel.lines
    assert np.asarray(estimate.get_xydata()).tolist() == [[1, 1], [2, 1], [3, 1], [4, 1]]
    assert set(np.asarray(zero.get_ydata()).tolist()) == {0.0}


def test_the_widest_level_lies_behind_and_is_the_palest() -> None:
    rows = _rows({99.0: 5.0, 90.0: 3.0, 95.0: 4.0})
    drawn = ordered_intervals(rows, "simulated")
    for panel in drawn.figure.axes:
        orders = [region.get_zorder() for region in panel.collections]
        assert orders == sorted(orders, reverse=True)
        brightness = [
            float(np.asarray(region.get_facecolor())[0, :3].sum()) for region in panel.collections
        ]
        assert brightness == sorted(brightness)
    texts = [text.get_text() for text in drawn.figure.legends[0].get_texts()]
    assert texts == ["90 % interval", "95 % interval", "99 % interval", "estimate", "truth"]


def test_titles_count_coverage_and_axes_have_units() -> None:
    rows = _rows({90.0: 3.0, 95.0: 0.5})
    panels = ordered_intervals(rows, "simulated").figure.axes
    assert panels[0].get_title() == "X: 100.0 / 0.0 % covered"
    assert panels[0].get_ylabel() == "Deviation from true X (cm)"
    assert panels[4].get_ylabel() == "Deviation from true Pitch (°)"
    assert panels[5].get_xlabel() == "Test frame, in order of truth"


def test_coverage_is_counted_before_smoothing() -> None:
    rows = _predictions(200)
    missed = np.arange(len(rows)) % 2 == 0  # every second frame
    rows.loc[missed, "upper_90"] = rows.loc[missed, "truth"] - 0.01
    drawn = ordered_intervals(rows, "simulated")
    assert drawn.figure.axes[0].get_title() == "X: 50.0 % covered"
    assert "moving average of 9 frames" in drawn.caption
    assert "counted before smoothing" in drawn.caption
    # Smoothed, the region holds the truth nearly everywhere.
    heights = [y for x, y in _corners(drawn.figure.axes[0], 0) if 10 < x < 190 and y != 0]
    assert np.mean(np.array(heights) > 0) == pytest.approx(0.5, abs=0.02)


def test_infinite_levels_are_said_and_not_drawn() -> None:
    drawn = ordered_intervals(_rows({90.0: 3.0, 99.0: math.inf}), "simulated")
    assert drawn.figure.axes[0].get_title() == "X: 100.0 / ∞ % covered"
    texts = [text.get_text() for text in drawn.figure.legends[0].get_texts()]
    assert texts == ["90 % interval", "estimate", "truth"]
    assert "Intervals of 99 % are infinite" in drawn.caption
    none = ordered_intervals(_rows({99.0: math.inf}), "simulated")
    assert none.figure.axes[0].get_title() == "X: no finite interval"


def test_thousands_of_frames_are_thinned_after_smoothing() -> None:
    panel = ordered_intervals(_predictions(5000), "simulated").figure.axes[0]
    xy = np.asarray(panel.lines[0].get_xydata())
    assert POINTS <= len(xy) < 2 * POINTS
    assert xy[0, 0] == 1
    assert xy[-1, 0] > 4980


@pytest.mark.parametrize("n", [1, 4, 50, 51, 5000])
def test_the_window_is_odd_and_a_25th(n: int) -> None:
    window = smoothing_window(n)
    assert window % 2 == 1
    assert abs(window - n / 25) <= 1 + n % 2


def test_moving_average_against_a_plain_loop() -> None:
    values = np.random.default_rng(1).normal(size=40)
    for window in (1, 3, 9, 79, 99):
        half = window // 2
        expected = [values[max(0, i - half) : i + half + 1].mean() for i in range(40)]
        assert moving_average(values, window) == pytest.approx(expected)


def test_an_infinite_value_is_a_gap_and_spoils_nothing_else() -> None:
    values = np.array([1.0, 1.0, np.inf, 1.0, 1.0, 1.0])
    means = moving_average(values, 3)
    assert np.isnan(means).tolist() == [False, True, True, True, False, False]
    assert means[[0, 4, 5]].tolist() == [1.0, 1.0, 1.0]
