"""The control inside a whole test: run before it, and a row of its tables."""

from __future__ import annotations

import csv
from pathlib import Path

import lightning
import pytest
import torch
from lightning.pytorch.loggers import CSVLogger, Logger
from torch import Tensor, nn

from uncal.callbacks.image_blind import ImageBlindControl
from uncal.callbacks.report import Report
from uncal.callbacks.uncertainty_calibration import UncertaintyCalibration
from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.network_input import InputSettings
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.geometry.decalibration import DecalibrationRange
from uncal.models.estimator import PoseEstimator
from uncal.models.module import CalibrationModule
from uncal.models.run_state import RunState
from uncal.recordings.kitti import KittiRaw
from uncal.splits.split_settings import SplitSettings
from uncal.uncertainty import ConformalCalibrator, MCDropout

# So few frames make infinite intervals.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)


class Reader(nn.Module):
    """Linear in the means of some channels."""

    def __init__(self, channels: slice) -> None:
        super().__init__()
        self.channels = channels
        self.layers = nn.Sequential(nn.LazyLinear(16), nn.Dropout(0.3), nn.Linear(16, 6))

    def forward(self, x: Tensor) -> Tensor:
        means: Tensor = self.layers(x[:, self.channels].mean((2, 3)))
        return means


def run_test(
    root: Path,
    folder: Path,
    channels: slice,
    *callbacks: lightning.Callback,
    logger: Logger | None = None,
) -> RunState:
    torch.manual_seed(0)
    network = Reader(channels)
    network(torch.ones(1, 5, 4, 4))
    module = CalibrationModule(
        estimator=PoseEstimator(
            network,
            RANGE.bounds,
            ridge=0.1,
            displacement_weight=0.5,
            quantile_levels=(0.05, 0.95),
        ),
        optimizer=lambda parameters: torch.optim.SGD(parameters, lr=1e-3),
        warmup_fraction=0.1,
        engine=lambda network, masks: MCDropout(network, 4, masks=masks),
        spread="dropout",
        fixed_masks=False,
        calibrator=ConformalCalibrator(DOF_NAMES, 1e-9),
        groups="rig",
        mask_seed=0,
    )
    data = CalibrationDataModule(
        recording=KittiRaw(root),
        image_size=(64, 96),
        decalibration=RANGE,
        split=SplitSettings("frame", (0.12, 0.12, 0.32, 0.44), seed=0),
        loader=LoaderSettings(batch_size=2, eval_batch_size=2, workers=0, cache=False),
        inputs=InputSettings(
            channels=["rgb", "inverse_depth", "intensity"],
            inverse_depth_scale=10.0,
            intensity_scale=2.0,
            rgb_mean=0.5,  # images of noise: their means differ in the second digit
            rgb_std=0.007,
        ),
        augmentation=Augmentation(mirror=0.5, brightness=0.1, contrast=0.1),
        seed=5,
    )
    report = Report(str(folder), levels=[0.5], label="generated")
    trainer = lightning.Trainer(
        accelerator="cpu",
        logger=logger or False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        callbacks=[report, *callbacks, UncertaintyCalibration(levels=[0.5])],
    )
    trainer.test(module, datamodule=data, verbose=False)
    return module.run


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_control_is_a_row_of_the_tables(
    kitti_raw_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = run_test(kitti_raw_root, tmp_path, slice(0, 3), ImageBlindControl())
    assert state.control is not None
    assert len(state.control.index) == 4
    read = rows(tmp_path / "control.csv")
    assert [row["dof"] for row in read] == list(DOF_NAMES)
    for row, result in zip(read, rows(tmp_path / "results.csv"), strict=True):
        assert float(row["mae_before"]) == pytest.approx(float(result["mae_before"]))
        assert row["mae_mean"] == result["mae_after"]
        assert row["n"] == "4"
    assert [row["mae_single"] for row in read] != [row["mae_blind"] for row in read]
    predictions = rows(tmp_path / "predictions.csv")
    assert [row["frame"] for row in predictions[::6]] == [str(f) for f in state.control.frames]
    shown = capsys.readouterr().out
    assert "camera contributes (%)" in shown
    assert str(tmp_path / "control.csv") in shown
    assert "camera contributes (%)" in (tmp_path / "results.md").read_text(encoding="utf-8")


def test_the_metrics_of_the_table_are_logged(kitti_raw_root: Path, tmp_path: Path) -> None:
    logger = CSVLogger(tmp_path, name="log", version="")
    run_test(kitti_raw_root, tmp_path, slice(0, 3), logger=logger)
    logger.save()
    (logged,) = rows(tmp_path / "log" / "metrics.csv")
    assert len([name for name in logged if name.startswith("test ")]) == 18
    for row in rows(tmp_path / "results.csv"):
        dof, unit = row["dof"], row["unit"]
        for name, column in (
            (f"test PICP 50% (%)/{dof}", "picp"),
            (f"test MPIW 50%/{dof} ({unit})", "mpiw"),
            (f"test IS 50%/{dof} ({unit})", "is"),
        ):
            assert float(logged[name]) == pytest.approx(float(row[column]), rel=1e-5)


def test_a_network_that_reads_points_alone(kitti_raw_root: Path, tmp_path: Path) -> None:
    run_test(kitti_raw_root, tmp_path, slice(3, 5), ImageBlindControl())
    for row in rows(tmp_path / "control.csv"):
        ends = [float(row[f"contribution{end}"]) for end in ("", "_low", "_high")]
        assert ends == [0.0, 0.0, 0.0]


def test_the_control_changes_no_other_number(kitti_raw_root: Path, tmp_path: Path) -> None:
    run_test(kitti_raw_root, tmp_path / "with", slice(0, 5), ImageBlindControl())
    run_test(kitti_raw_root, tmp_path / "without", slice(0, 5))
    names = {path.name for path in (tmp_path / "without").iterdir()}
    assert {path.name for path in (tmp_path / "with").iterdir()} == {*names, "control.csv"}
    for name in names - {"results.md"}:
        one, other = (tmp_path / folder / name for folder in ("with", "without"))
        assert one.read_bytes() == other.read_bytes()
    text = (tmp_path / "without" / "results.md").read_text(encoding="utf-8")
    assert "contributes" not in text


def test_one_readable_frame_has_a_table_without_it(kitti_raw_root: Path, tmp_path: Path) -> None:
    state = run_test(kitti_raw_root, tmp_path / "first", slice(0, 5), ImageBlindControl())
    assert state.control is not None
    for frame in state.control.frames[1:]:
        (scan,) = kitti_raw_root.rglob(f"{frame.drive}/velodyne_points/data/{frame.index:010d}.bin")
        scan.write_bytes(scan.read_bytes()[:-5])
    state = run_test(kitti_raw_root, tmp_path / "second", slice(0, 5), ImageBlindControl())
    assert state.control is None
    assert not (tmp_path / "second" / "control.csv").exists()
    assert {row["n_test"] for row in rows(tmp_path / "second" / "results.csv")} == {"1"}
    assert len(rows(tmp_path / "second" / "skipped.csv")) == 3


def test_foreign_modules_are_refused() -> None:
    trainer = lightning.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    with pytest.raises(ConfigurationError, match=r"drop callbacks\.control"):
        ImageBlindControl().on_test_start(trainer, lightning.LightningModule())
