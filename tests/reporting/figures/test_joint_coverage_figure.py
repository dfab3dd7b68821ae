from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from uncal.reporting.figures.run_figures import joint_coverage


def rows(*levels: tuple[float, float, float]) -> pd.DataFrame:
    """Level, six intervals together, joint box."""
    frame: pd.DataFrame = pd.DataFrame(
        [
            {
                "level": level,
                "together": together,
                "joint": joint,
                "joint_low": level - 8,
                "joint_high": level + 4,
                "joint_in_band": True,
                "bonferroni": 99.0,
                "bonferroni_size": 1.1,
                "n_test": 200,
                "n_calibration": 300,
            }
            for level, together, joint in levels
        ]
    )
    return frame


ROWS = rows((90.0, 67.0, 91.5), (50.0, 11.0, 52.0), (95.0, 80.0, 95.5))


def test_curves_are_drawn_in_the_order_of_the_levels() -> None:
    (panel,) = joint_coverage(ROWS, "simulated", "").figure.axes
    drawn = {str(line.get_label()): line for line in panel.get_lines()}
    for name, values in (
        ("six intervals at once", [11.0, 67.0, 80.0]),
        ("joint box", [52.0, 91.5, 95.5]),
        ("Bonferroni box", [99.0, 99.0, 99.0]),
    ):
        assert np.asarray(drawn[name].get_xdata()).tolist() == [50.0, 90.0, 95.0]
        assert np.asarray(drawn[name].get_ydata()).tolist() == values
    assert panel.get_xlabel() == "Nominal coverage (%)"
    assert panel.get_ylim() == (0, 100)


def test_the_band_is_that_of_the_joint_box() -> None:
    (panel,) = joint_coverage(ROWS, "simulated", "").figure.axes
    (band,) = panel.collections
    vertices = np.asarray(band.get_paths()[0].vertices, dtype=float)
    corners = {(float(x), float(y)) for x, y in vertices}
    assert {(50.0, 42.0), (50.0, 54.0), (90.0, 82.0), (95.0, 99.0)} <= corners
    assert band.get_label() == "reference band of the joint box"


@pytest.mark.parametrize(
    ("caveat", "words"),
    [
        ("", "of the Beta-Binomial law. Dotted"),
        (None, "if frames are exchangeable"),
        ("by rig", "for reference only here: by rig"),
    ],
)
def test_the_caption_gives_the_numbers_and_what_the_band_is(caveat: str | None, words: str) -> None:
    caption = joint_coverage(ROWS, "simulated", caveat).caption
    assert "200 test frames, all six 90 % intervals hold at once in 67.0 %" in caption
    assert "the joint box in 91.5 %" in caption
    assert words in caption
