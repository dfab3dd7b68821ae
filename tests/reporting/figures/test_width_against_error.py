from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.figures.predictions import rank_correlation, width_against_error

ERROR = np.array([1.0, -2.0, 3.0, 4.0])
HALF = np.array([2.0, 1.0, 5.0, 4.5])
"""The second frame is missed. Ranks 1 2 3 4 and 2 1 4 3: ρ = 1 - 6·4/(4·15) = 0.6."""


def _predictions(bounds: dict[float, tuple[float, float]]) -> pd.DataFrame:
    """Truth 10 everywhere; level → factors of the half widths below and above the estimate."""
    estimate = 10.0 + ERROR
    return _of_all_dof(
        {"truth": np.full(4, 10.0), "estimate": estimate}
        | {f"lower_{level:g}": estimate - a * HALF for level, (a, _) in bounds.items()}
        | {f"upper_{level:g}": estimate + b * HALF for level, (_, b) in bounds.items()}
    )


def _of_all_dof(values: Mapping[str, NDArray[np.float64]]) -> pd.DataFrame:
    parts = [
        pd.DataFrame({"dof": dof, "unit": unit} | dict(values))
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
    ]
    frame: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return frame


def _points(panel: Axes, k: int) -> list[list[float]]:
    return [[float(x), float(y)] for x, y in np.asarray(panel.collections[k].get_offsets())]


def test_points_line_and_correlation() -> None:
    drawn = width_against_error(_predictions({90.0: (1, 1), 95.0: (2, 2)}), "simulated")
    assert drawn is not None
    for panel, dof, unit in zip(drawn.figure.axes, DOF_NAMES, DOF_UNITS, strict=True):
        assert _points(panel, 0) == [[1, 4], [3, 10], [4, 9]]
        assert _points(panel, 1) == [[2, 2]]
        (start, end) = np.asarray(panel.lines[0].get_xydata()).tolist()
        assert start == [0, 0]
        assert end[1] == 2 * end[0]
        assert panel.get_title() == f"{dof}: ρ = 0.60"
        assert panel.get_xlabel() == f"|error| of {dof} ({unit})"
        assert panel.get_ylabel() == f"Width of 90 % interval ({unit})"
        assert panel.get_xlim()[1] > 4
        assert panel.get_ylim()[1] > 10
    assert "above it the interval holds the truth" in drawn.caption
    assert "4 test frames" in drawn.caption


def test_the_line_is_only_a_guide_where_intervals_are_not_centred() -> None:
    drawn = width_against_error(_predictions({90.0: (1, 2)}), "simulated")
    assert drawn is not None
    assert "only a guide" in drawn.caption
    assert _points(drawn.figure.axes[0], 1) == []  # the wider side holds the second frame


def test_the_level_is_90_or_else_the_lowest_finite_one() -> None:
    drawn = width_against_error(_predictions({50.0: (0.5, 0.5), 80.0: (1, 1)}), "simulated")
    assert drawn is not None
    assert drawn.title == "Width of the 50 % intervals against error"
    drawn = width_against_error(
        _predictions({80.0: (1, 1), 90.0: (math.inf, math.inf)}), "simulated"
    )
    assert drawn is not None
    assert "80 %" in drawn.figure.axes[0].get_ylabel()
    assert width_against_error(_predictions({90.0: (math.inf, math.inf)}), "simulated") is None


def test_equal_widths_have_no_correlation() -> None:
    rows = _predictions({90.0: (1, 1)})
    rows["lower_90"], rows["upper_90"] = rows["estimate"] - 0.1, rows["estimate"] + 0.1
    drawn = width_against_error(rows, "simulated")
    assert drawn is not None
    assert drawn.figure.axes[2].get_title() == "Z: no ρ, equal widths"


def test_rank_correlation() -> None:
    assert rank_correlation(np.array([1.0, 2, 3]), np.array([9.0, 5, 1])) == -1.0
    # Ties share their rank: (1.5, 1.5, 3) against (1, 2, 3) is sqrt(3)/2.
    tied = rank_correlation(np.array([1.0, 1, 2]), np.array([1.0, 2, 3]))
    assert tied == pytest.approx(math.sqrt(3) / 2)
    assert math.isnan(rank_correlation(np.array([1.0]), np.array([1.0])))
    rounding = 1.0 + np.array([0, 1, 2]) * 2.0**-52
    assert math.isnan(rank_correlation(rounding, np.array([1.0, 2, 3])))


def test_thousands_of_points_are_pixels_in_the_pdf() -> None:
    rng = np.random.default_rng(0)
    truth = np.zeros(5000)
    half = rng.uniform(1, 2, 5000)
    estimate = rng.normal(size=5000)
    values = {"truth": truth, "estimate": estimate}
    values |= {"lower_90": estimate - half, "upper_90": estimate + half}
    drawn = width_against_error(_of_all_dof(values), "simulated")
    assert drawn is not None
    held, missed = drawn.figure.axes[0].collections
    assert held.get_rasterized()
    assert missed.get_rasterized()
    few = width_against_error(_predictions({90.0: (1, 1)}), "simulated")
    assert few is not None
    assert float(held.get_alpha() or 1) < float(few.figure.axes[0].collections[0].get_alpha() or 1)
    assert float(held.get_alpha() or 1) < float(missed.get_alpha() or 1)
