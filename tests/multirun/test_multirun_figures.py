"""Figures of multiruns made by hand."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from uncal.geometry import DOF_NAMES
from uncal.multirun.figures import draw_figures, sweep_figures
from uncal.reporting.figures.style import NamedFigure

Value = str | float


def summary(
    keys: Sequence[str],
    jobs: Sequence[tuple[Sequence[str], Mapping[str, Value]]],
    levels: Sequence[float] = (90.0,),
) -> pd.DataFrame:
    """X of every job has its numbers, each further DoF one tenth more."""
    rows: list[dict[str, Value]] = []
    for number, (values, own) in enumerate(jobs):
        for level in levels:
            for j, dof in enumerate(DOF_NAMES):
                row: dict[str, Value] = dict(zip(keys, values, strict=True))
                row |= {"dof": dof, "level": level, "picp": 90.0, "mpiw": 1.0, "is": 2.0}
                row |= {"mae_after": 1.0, "coverage_low": 80.0, "coverage_high": 97.0}
                row |= {k: v + 0.1 * j if isinstance(v, float) else v for k, v in own.items()}
                rows.append(row | {"label": "made-up", "folder": str(number)})
    frame: pd.DataFrame = pd.DataFrame(rows)
    return frame


def drawn(frame: pd.DataFrame) -> dict[str, NamedFigure]:
    return {figure.name: figure for figure in sweep_figures(frame)}


def line(panel: Axes, label: str) -> tuple[list[float], list[float]]:
    (found,) = (each for each in panel.lines if each.get_label() == label)
    return points(found)


def points(found: Line2D) -> tuple[list[float], list[float]]:
    x, y = np.asarray(found.get_data(), dtype=np.float64).round(6).tolist()
    return x, y


def test_passes_with_mask_seeds_are_lines_with_a_band() -> None:
    jobs = [((p, s), {"is": 10 / int(p) + int(s)}) for p in ("5", "10", "50") for s in ("0", "2")]
    frame = summary(("mcd.passes", "mcd.seed"), jobs, levels=(90.0, 99.0))
    figure = drawn(frame)["interval_score"]
    translation, rotation, *second_level = figure.figure.axes
    assert len(second_level) == 2
    # means over the seeds and over X, Y, Z; seed 2 is 2 above seed 0
    assert points(translation.lines[0]) == ([5.0, 10.0, 50.0], [3.1, 2.1, 1.3])
    assert points(rotation.lines[0])[1] == [3.4, 2.4, 1.6]
    (band,) = translation.collections
    assert band.get_datalim(translation.transData).bounds == pytest.approx((5, 0.3, 45, 3.8))
    assert line(translation, "25, the paper's choice")[0] == [25.0, 25.0]
    assert translation.get_ylabel() == "Interval score (cm)"
    assert second_level[0].get_xlabel() == "Stochastic passes"
    assert "means over the mask seeds (2 runs)" in figure.caption
    assert "made-up" in [text.get_text() for text in figure.figure.texts]


def test_one_run_per_value_has_no_band() -> None:
    frame = summary(("mcd.passes",), [((p,), {}) for p in ("5", "10")])
    figure = drawn(frame)["interval_score"]
    assert "One run per value." in figure.caption
    assert not figure.figure.axes[0].collections


def test_coverage_shows_every_dof_and_the_laws_band() -> None:
    frame = summary(("mcd.passes",), [((p,), {"picp": float(p)}) for p in ("80", "90")])
    (panel,) = drawn(frame)["coverage"].figure.axes
    assert line(panel, "Y") == ([80.0, 90.0], [80.1, 90.1])
    (band,) = panel.collections
    assert band.get_datalim(panel.transData).bounds == (80, 80, 10, 17)


def test_a_second_key_gives_a_line_per_value() -> None:
    keys = ("model.head_dropout", "model.backbone_dropout")
    jobs = [((h, b), {"mpiw": float(b)}) for h in ("0.05", "0.10") for b in ("0.1", "0.2", "0.4")]
    frame = summary(keys, jobs)
    panel, _ = drawn(frame)["interval_width"].figure.axes
    assert line(panel, "0.10") == ([0.1, 0.2, 0.4], [0.2, 0.3, 0.5])
    assert line(panel, "0.05") == line(panel, "0.10")
    assert panel.get_xlabel() == "Backbone dropout rate"
    assert "whole_pose" not in drawn(frame)


def test_names_are_rows_of_dots() -> None:
    jobs = [(("conformal",), {"mpiw": 2.0, "is": 4.0}), (("gaussian",), {"mpiw": 1.0, "is": 8.0})]
    frame = summary(("interval",), jobs)
    figures = drawn(frame)
    assert list(figures) == ["coverage", "interval_width"]  # the errors are the same
    width, score = figures["interval_width"].figure.axes
    assert line(width, "X")[0] == [1.0, 0.5]
    assert line(score, "X")[0] == [1.0, 2.0]
    assert [tick.get_text() for tick in width.get_yticklabels()] == ["conformal", "gaussian"]
    assert width.get_ylim() == (1.5, -0.5)  # the first row on top
    assert "“conformal”" in figures["interval_width"].caption


def test_what_is_infinite_is_left_out() -> None:
    jobs = [((p,), {"is": score}) for p, score in (("5", np.inf), ("10", 3.0), ("20", 2.0))]
    frame = summary(("mcd.passes",), jobs)
    translation = drawn(frame)["interval_score"].figure.axes[0]
    assert points(translation.lines[0])[0] == [10.0, 20.0]
    frame = summary(("mcd.passes",), [((p,), {"is": np.inf}) for p in ("5", "10")])
    assert "interval_score" not in drawn(frame)


def test_the_whole_pose_and_the_camera_where_they_are_known() -> None:
    own = {"together": 60.0, "joint": 91.0, "contribution": 50.0}
    ends: dict[str, Value] = {"contribution_low": 40.0, "contribution_high": 60.0}
    jobs = [((b,), own | ends | {"contribution": c}) for b, c in (("frame", 50.0), ("rig", 55.0))]
    frame = summary(("split.by",), jobs)
    figures = drawn(frame)
    (pose,) = figures["whole_pose"].figure.axes
    assert pose.get_legend_handles_labels()[1] == ["six at once", "joint box"]
    (camera,) = figures["camera"].figure.axes
    assert line(camera, "X")[0] == [50.0, 55.0]
    assert [40.0, 60.0] in [points(each)[0] for each in camera.lines]
    assert "bootstrap" in figures["camera"].caption


def test_seeds_alone_show_their_spread() -> None:
    frame = summary(("seed",), [((s,), {"picp": 90.0 + int(s)}) for s in ("0", "1", "2")])
    panel = drawn(frame)["coverage"].figure.axes[0]
    assert line(panel, "X")[0] == [91.0]
    assert [90.0, 92.0] in [points(each)[0] for each in panel.lines]


def test_one_job_shows_nothing() -> None:
    frame = summary(("mcd.passes",), [(("5",), {})])
    assert drawn(frame) == {}


def test_figures_are_saved_with_their_captions_and_old_ones_go(tmp_path: Path) -> None:
    frame = summary(("interval",), [((i,), {}) for i in ("conformal", "gaussian")])
    place = tmp_path / "figures"
    place.mkdir()
    for name in ("interval_score.png", "interval_score.pdf", "of_the_user.png"):
        (place / name).write_bytes(b"")
    (place / "captions.csv").write_text("name,title,caption\ninterval_score,Old,Older.\n")
    paths = draw_figures(tmp_path, frame)
    assert [path.name for path in paths] == ["coverage.png", "interval_width.png"]
    assert {path.name for path in place.iterdir()} == {
        *("coverage.png", "coverage.pdf", "interval_width.png", "interval_width.pdf"),
        *("captions.csv", "of_the_user.png"),
    }
    with (place / "captions.csv").open(encoding="utf-8") as file:
        assert [row["title"] for row in csv.DictReader(file)] == [
            "Coverage by interval method",
            "Interval width by interval method",
        ]
