from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import lightning
import pytest
from lightning import Trainer
from lightning.pytorch.loggers import CSVLogger, Logger, TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
    EventAccumulator,
)

from uncal.callbacks.figures import Figures
from uncal.geometry import DOF_NAMES

CURVE = "dof,level,picp,coverage_low,coverage_high,in_band\n" + "".join(
    f"{dof},{level},{level},{level - 5},{level + 5},True\n"
    for dof in DOF_NAMES
    for level in (50.0, 90.0)
)
PREDICTIONS = "frame,dof,unit,truth,estimate,sigma,lower_90,upper_90\n" + "".join(
    f"{i},{dof},cm,{i},{i + 0.5},1.0,{i - 1},{i + 2 + 0.1 * i}\n"
    for i in range(4)
    for dof in DOF_NAMES
)


def trainer(*loggers: Logger, zero: bool = True) -> Trainer:
    return cast(Trainer, SimpleNamespace(is_global_zero=zero, loggers=list(loggers), global_step=7))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "calibration_curve.csv").write_text(CURVE, encoding="utf-8")
    (tmp_path / "predictions.csv").write_text(PREDICTIONS, encoding="utf-8")
    return tmp_path


def _stems(run: Path) -> dict[str, list[str]]:
    kinds = ("png", "pdf")
    return {kind: sorted(path.stem for path in run.glob(f"figures/*.{kind}")) for kind in kinds}


def test_figures_become_files_and_go_to_tensorboard_only(run: Path) -> None:
    board = TensorBoardLogger(run, name="", version="")
    callback = Figures(str(run), "simulated")
    callback.teardown(trainer(CSVLogger(run), board), lightning.LightningModule(), "test")
    board.finalize("success")
    names = ["calibration_curves", "ordered_intervals", "width_against_error"]
    assert _stems(run) == {"png": names, "pdf": names}
    events = EventAccumulator(str(run))
    events.Reload()
    assert sorted(events.Tags()["images"]) == [f"figure/{name}" for name in names]
    (picture,) = events.Images("figure/ordered_intervals")
    assert (picture.step, picture.width) == (7, 1400)


def test_other_processes_draw_nothing(run: Path) -> None:
    other = trainer(zero=False)
    Figures(str(run), "simulated").teardown(other, lightning.LightningModule(), "test")
    assert not (run / "figures").exists()


def test_a_figure_that_fails_is_named_and_the_others_are_drawn(
    run: Path, caplog: pytest.LogCaptureFixture
) -> None:
    damaged = PREDICTIONS.replace("lower_90", "lower_x")
    (run / "predictions.csv").write_text(damaged, encoding="utf-8")
    with caplog.at_level(logging.ERROR):
        Figures(str(run), "simulated").teardown(trainer(), lightning.LightningModule(), "test")
    assert _stems(run)["png"] == ["calibration_curves"]
    assert [record.getMessage().split(":")[0] for record in caplog.records] == [
        "figure ordered_intervals was not drawn",
        "figure width_against_error was not drawn",
    ]
    assert "predictions.csv" in caplog.text


def test_a_folder_that_cannot_be_written_costs_no_run(
    run: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (run / "figures").write_text("in the way", encoding="utf-8")
    Figures(str(run), "simulated").teardown(trainer(), lightning.LightningModule(), "test")
    assert len([record for record in caplog.records if record.levelno == logging.ERROR]) == 3


def test_a_run_without_tables_has_no_figures(tmp_path: Path) -> None:
    Figures(str(tmp_path), "simulated").teardown(trainer(), lightning.LightningModule(), "test")
    assert list(tmp_path.iterdir()) == []
