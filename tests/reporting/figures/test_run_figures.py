from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from torch import Tensor

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.figures.run_figures import figure_makers, run_figures
from uncal.reporting.measure import measure
from uncal.reporting.report import write_report
from uncal.reporting.run import Run, read_run
from uncal.uncertainty import ConformalCalibrator

NAMES = ["calibration_curves", "joint_coverage", "ordered_intervals", "width_against_error"]


def _predictions(n: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    target = 0.1 * torch.rand(n, 6, generator=generator)
    std = 0.01 + 0.02 * torch.rand(n, 6, generator=generator)
    return target + std * torch.randn(n, 6, generator=generator), std, target


def _settings(calibrator: str, **split: str) -> dict[str, object]:
    target = {"_target_": f"uncal.uncertainty.{calibrator}"}
    return {"interval": {"calibrator": target}, "split": {"by": "frame"} | split}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    calibrator = ConformalCalibrator(DOF_NAMES).fit(*_predictions(200, seed=1))
    tested = _predictions(40, seed=0)
    frames = [str(i) for i in range(40)]
    results = measure(Evaluation(*tested, calibrator), [0.9], frames=frames)
    write_report(tmp_path, results, label="simulated")
    return tmp_path


def labelled(folder: Path, label: str = "simulated") -> Run:
    return Run(folder, {"label": label})


def caveat(settings: dict[str, object]) -> str | None:
    return Run(Path(), {"settings": settings}).caveat


def test_all_figures_of_a_run(run: Path) -> None:
    figures = run_figures(labelled(run, "simulated street-scene"))
    assert [figure.name for figure in figures] == NAMES
    for figure in figures:
        assert figure.title
        assert len(figure.caption) > 60
        assert "simulated street-scene" in [text.get_text() for text in figure.figure.texts]


def test_missing_files_mean_fewer_figures(run: Path) -> None:
    (run / "predictions.csv").unlink()
    assert [figure.name for figure in run_figures(labelled(run))] == NAMES[:2]
    (run / "joint.csv").unlink()
    (run / "calibration_curve.csv").unlink()
    assert run_figures(labelled(run)) == []


def test_a_damaged_file_is_an_error_of_its_own_figures_only(run: Path) -> None:
    (run / "predictions.csv").write_text("frame,dof\n", encoding="utf-8")
    with pytest.raises(UncalError, match=r"predictions\.csv"):
        run_figures(labelled(run))
    assert figure_makers(labelled(run))["calibration_curves"]() is not None


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({"settings": _settings("ConformalCalibrator")}, "points lie outside"),
        ({"settings": _settings("GaussianIntervals")}, "guarantees no coverage"),
        ({"settings": _settings("ConformalCalibrator", by="drive")}, "the split is by drive"),
        ({"settings": None}, "for reference only with other methods"),
        ({}, "for reference only with other methods"),
    ],
)
def test_the_record_of_the_run_says_what_the_band_is(
    run: Path, record: dict[str, object], words: str
) -> None:
    (run / "run.json").write_text(json.dumps(record), encoding="utf-8")
    assert words in run_figures(read_run(run))[0].caption


def test_what_settings_tell() -> None:
    assert caveat(_settings("ConformalCalibrator")) == ""
    assert "by group" in (caveat(_settings("MondrianCalibrator")) or "")
    assert "by group" in (caveat(_settings("HierarchicalCalibrator")) or "")
    assert caveat(_settings("QuantileCalibrator")) == ""
    assert "rigs" in (caveat(_settings("AbsoluteCalibrator", test="unseen")) or "")
    assert caveat(_settings("SomethingOfTheUsers")) is None
    assert caveat({}) is None
    assert caveat({"interval": 3, "split": None}) is None
