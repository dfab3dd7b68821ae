from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from uncal.geometry import DOF_NAMES
from uncal.reporting.evaluation import band_caveat
from uncal.reporting.figures.run_figures import calibration_curves
from uncal.reporting.figures.style import DOF_COLOURS, DOF_LINES, DOF_MARKERS
from uncal.reporting.frames import CURVE

COLUMNS = "dof,level,picp,coverage_low,coverage_high,in_band\n"


def _rows() -> pd.DataFrame:
    """Observed: 50 + j and 90 - j for the j-th DoF; Yaw's 85 is below the band of 86..94."""
    rows = [
        (dof, level, picp, low, high, low <= picp <= high)
        for j, dof in enumerate(DOF_NAMES)
        for level, picp, low, high in ((50.0, 50.0 + j, 40.0, 60.0), (90.0, 90.0 - j, 86.0, 94.0))
    ]
    frame: pd.DataFrame = pd.DataFrame(rows, columns=list(CURVE.columns))
    return frame


def _curves(panel: Axes) -> dict[object, list[tuple[float, float]]]:
    return {
        line.get_label(): [(float(x), float(y)) for x, y in np.asarray(line.get_xydata())]
        for line in panel.lines
        if not str(line.get_label()).startswith("_")
    }


def _corners(panel: Axes) -> set[tuple[float, float]]:
    (band,) = panel.collections
    return {(float(x), float(y)) for x, y in np.asarray(band.get_paths()[0].vertices)}


def test_curves_band_and_diagonal_are_the_rows() -> None:
    figure = calibration_curves(_rows(), "simulated", "").figure
    translations, rotations, below_left, below_right = figure.axes
    assert list(_curves(translations)) == ["X", "Y", "Z"]
    assert list(_curves(rotations)) == ["Roll", "Pitch", "Yaw"]
    assert _curves(rotations)["Yaw"] == [(50.0, 55.0), (90.0, 85.0)]
    assert _curves(below_right)["Yaw"] == [(50.0, 5.0), (90.0, -5.0)]
    assert _curves(below_left)["Y"] == [(50.0, 1.0), (90.0, -1.0)]
    for panel in (translations, rotations):
        assert {(50, 40), (90, 86), (90, 94), (50, 60)} <= _corners(panel)
        assert panel.lines[0].get_xydata().tolist() == [[0, 0], [100, 100]]  # type: ignore[union-attr]
    assert {(50, -10), (90, -4), (90, 4), (50, 10)} <= _corners(below_left)
    assert below_left.lines[0].get_xydata().tolist() == [[0, 0], [100, 0]]  # type: ignore[union-attr]
    assert below_left.get_ylim() == below_right.get_ylim()


def test_axes_say_what_they_show_in_percent() -> None:
    figure = calibration_curves(_rows(), "simulated street-scene", "").figure
    assert [panel.get_title() for panel in figure.axes[:2]] == ["Translations", "Rotations"]
    assert figure.axes[0].get_ylabel() == "Empirical coverage (%)"
    assert figure.axes[3].get_xlabel() == "Nominal coverage (%)"
    assert "percentage points" in figure.axes[2].get_ylabel()
    assert [text.get_text() for text in figure.texts] == ["simulated street-scene"]


def test_each_dof_has_its_own_colour_line_and_marker() -> None:
    figure = calibration_curves(_rows(), "simulated", "").figure
    for line in figure.axes[0].lines[1:] + figure.axes[1].lines[1:]:
        dof = str(line.get_label())
        assert line.get_color() == DOF_COLOURS[dof]
        assert line.get_linestyle() == DOF_LINES[dof]
        assert line.get_marker() == DOF_MARKERS[dof]


@pytest.mark.parametrize(
    ("caveat", "legend", "caption"),
    [
        ("", "99.9 % reference band (Beta-Binomial)", "1 of 12 points lie outside."),
        (
            "no guarantee",
            "99.9 % reference band, not binding",
            "reference only here: no guarantee.",
        ),
        (None, "99.9 % reference band (Beta-Binomial)", "for reference only with other methods."),
    ],
)
def test_the_band_is_called_what_it_is(caveat: str | None, legend: str, caption: str) -> None:
    drawn = calibration_curves(_rows(), "simulated", caveat)
    assert drawn.caption.endswith(caption)
    assert drawn.figure.legends[0].get_texts()[0].get_text() == legend


def test_why_the_band_is_not_binding() -> None:
    assert band_caveat("exact", "frame") == ""
    assert "by rig" in band_caveat("exact", "rig")
    assert "rigs" in band_caveat("exact", "frame", test="unseen")
    assert "guarantees no coverage" in band_caveat("none", "frame")
    assert "by group" in band_caveat("by group", "frame")
