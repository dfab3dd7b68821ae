"""Calibration on one's own recordings: what it says of itself, and who takes its file."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast
from unittest.mock import patch

import numpy as np
import pytest
import torch
import yaml  # type: ignore[import-untyped]
from omegaconf import OmegaConf

from uncal.calibrate import with_layout
from uncal.calibrating.guarantee import choose_interval, possible_levels, summary
from uncal.errors import ConfigurationError, RecordingError
from uncal.geometry.decalibration import decalibrate
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction
from uncal.monitor.references import INSIDE, References, find_references
from uncal.recordings.folder_listing import layout_of
from uncal.recordings.frame import FrameId
from uncal.recordings.plain_folder import PlainFolder
from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.formats.bag import drive_as_bag
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated
from uncal.uncertainty import ConformalCalibrator, HierarchicalCalibrator, coverage_band
from uncal.weights.shipped import save_shipped

Run = Callable[..., "subprocess.CompletedProcess[str]"]

TINY = {
    "n_rigs": 1,
    "drives_per_rig": 10,
    "frames_per_drive": 2,
    "camera": {"height": 48, "width": 128, "focal_px": 140.0, "supersampling": 1},
    "lidar": {"beams": 32, "azimuth_step_deg": 0.6},
    "scene": {"view_m": 60.0},
}


def calibrated(
    kind: type[ConformalCalibrator], drives: int
) -> tuple[object, object, list[FrameId]]:
    torch.manual_seed(0)
    m = 50
    frames = [FrameId("rig", f"d{i % drives}", i) for i in range(m)]
    mean, std, target = torch.zeros(m, 6), torch.ones(m, 6), torch.rand(m, 6)
    scores = SplitPrediction(torch.arange(m), mean, std, target, torch.eye(6).expand(m, 6, 6))
    calibrator = kind().fit(mean, std, target, groups=scores.groups(frames, "drive"))

    def intervals(predicted: SplitPrediction, of: object, level: float) -> object:
        return calibrator.predict(predicted.mean, predicted.std, level)

    return SimpleNamespace(calibrator=calibrator, intervals=intervals), scores, frames


def told(kind: type[ConformalCalibrator], drives: int, levels: list[float]) -> str:
    module, scores, frames = calibrated(kind, drives)
    lines = summary(cast(CalibrationModule, module), cast(SplitPrediction, scores), frames, levels)
    return "\n".join(lines)


def test_the_summary_says_what_is_guaranteed_and_what_more_frames_buy() -> None:
    text = told(ConformalCalibrator, 1, [0.9, 0.99])
    low, high = coverage_band(10_000, 50, 0.1, 0.9)
    assert f"coverage is {100 * low:.1f}-{100 * high:.1f} %, with 200 frames" in text
    assert "99%: not possible; it takes 99 frames." in text
    module, _, _ = calibrated(ConformalCalibrator, 1)
    quantile = cast(CalibrationModule, module).calibrator.quantile(0.9)
    assert f"now ± X {100 * float(quantile[0]):.2f} cm" in text
    # ⌈51·0.95⌉ = 49 of 50; of 200 it is 191, as the 48th of 50.
    text = told(ConformalCalibrator, 1, [0.95])
    scores = cast(CalibrationModule, module).calibrator.scores[:, 0]
    assert f"now ± X {100 * float(scores[48]):.2f} cm" in text
    assert f"with 200 frames about ± X {100 * float(scores[47]):.2f} cm" in text


def test_of_the_hierarchical_method_drives_count() -> None:
    text = told(HierarchicalCalibrator, 10, [0.9, 0.95])
    low, high = coverage_band(10_000, 10, 0.1, 0.9)
    assert f"with 10 drives the coverage is {100 * low:.1f}-{100 * high:.1f} %" in text
    assert "95%: not possible; it takes 19 drives." in text


@pytest.mark.parametrize(("drives", "kind"), [(1, "Conformal"), (8, "Conformal"), (9, "Hier")])
def test_enough_drives_choose_the_hierarchical_method(drives: int, kind: str) -> None:
    interval = OmegaConf.create(
        {"levels": [0.9, 0.99], "groups": "rig", "calibrator": {"_target_": "ConformalCalibrator"}}
    )
    said = choose_interval(interval, drives)
    assert kind in interval.calibrator._target_
    assert said.startswith(f"interval={kind.lower()}")
    assert ("9 drives" in said) is (drives != 8 or "takes 9 drives" in said)
    assert possible_levels(interval.levels, drives) == ([0.9] if drives >= 9 else [])


def test_the_layout_chooses_the_dataset(tmp_path: Path, kitti_raw_root: Path) -> None:
    assert with_layout([f"recordings={kitti_raw_root}"])[1] == "dataset=kitti"
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "rig.yaml").touch()
    assert layout_of(tmp_path / "own", "recordings") == "folder"
    (tmp_path / "own" / "rig.yaml").unlink()
    with pytest.raises(RecordingError, match="none of the known layouts: a plain folder"):
        layout_of(tmp_path / "own", "recordings")
    with pytest.raises(SystemExit, match="no such folder"):
        with_layout([f"recordings={tmp_path / 'none'}"])
    refused = PermissionError(errno.EACCES, os.strerror(errno.EACCES), "own/rig.yaml")
    with (
        patch.object(Path, "is_file", side_effect=refused),
        pytest.raises(SystemExit, match=r"^own/rig.yaml: permission denied"),
    ):
        with_layout([f"recordings={tmp_path / 'own'}"])


@pytest.fixture(scope="module")
def own_rig(tmp_path_factory: pytest.TempPathFactory, start: Run) -> Path:
    """A plain folder of ten drives, converted from bags."""
    folder = tmp_path_factory.mktemp("own")
    street = OmegaConf.load(Path(CONFIG_DIR) / "simulation" / "street.yaml")
    merged = OmegaConf.to_container(OmegaConf.merge(street, TINY))
    settings = SimulationSettings.from_mapping(cast("dict[str, object]", merged))
    ensure_simulated(settings, folder / "sim", workers=1, progress=False)
    for number in range(1, 11):
        bag = drive_as_bag(folder / "sim", f"*_{number:04d}_sync", folder / f"bag{number:02d}")
        done = start("uncal.convert", f"source={bag}", f"root={folder / 'rig'}", cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder / "rig"


@pytest.fixture(scope="module")
def file(own_rig: Path, start: Run) -> Path:
    """Calibrated on it."""
    folder = own_rig.parent
    done = start(
        "uncal.calibrate",
        *("weights=unical", f"recordings={own_rig}", "dataset=folder", "out=mine.safetensors"),
        *("mcd.passes=4", "dataset.loader.workers=0", "hydra.run.dir=calibrated"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    assert "interval=hierarchical: frames of one drive are alike, so that the 10" in done.stdout
    assert "95%: not possible; it takes 19 drives." in done.stdout
    return folder / "mine.safetensors"


@pytest.mark.slow
def test_ros_files_hold_the_trusted_extrinsic(own_rig: Path, file: Path) -> None:
    said = yaml.safe_load(file.with_name("mine.transform.yaml").read_text())
    recording = PlainFolder(own_rig)
    T = recording.load(recording.frame_ids[0]).T_cam_lidar
    translation = [said["transform"]["translation"][axis] for axis in "xyz"]
    np.testing.assert_allclose(translation, T[:3, 3], atol=1e-9)
    covariance = np.reshape(said["covariance"], (6, 6))
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert (np.sqrt(np.diag(covariance)) < ([0.2] * 3 + [0.04] * 3)).all()
    assert file.with_name("mine.urdf").is_file()


@pytest.mark.slow
def test_evaluate_takes_the_file_with_its_calibration(
    own_rig: Path, file: Path, start: Run
) -> None:
    done = start(
        "uncal.evaluate",
        *(f"weights={file}", "dataset=folder", f"dataset.root={own_rig}", "refit=false"),
        *("dataset.loader.workers=0", "dataset.stride=2", "hydra.run.dir=evaluated"),
        *("callbacks.figures=null", "callbacks.interval_overlays=null"),
        cwd=own_rig.parent,
    )
    assert done.returncode == 0, done.stderr
    note = (own_rig.parent / "evaluated" / "results.md").read_text()
    assert "Intervals as calibrated on own rig data (refit=false)" in note


@pytest.mark.slow
def test_the_monitor_takes_the_file(own_rig: Path, file: Path, start: Run) -> None:
    done = start(
        "uncal.monitor.__main__",
        *(f"weights={file}", f"source={own_rig}", "stride=2", "hydra.run.dir=watched"),
        cwd=own_rig.parent,
    )
    assert done.returncode == 0, done.stderr
    assert "10 frames:" in done.stdout
    said = yaml.safe_load((own_rig.parent / "watched" / "estimate.transform.yaml").read_text())
    assert len(said["covariance"]) == 36


@pytest.mark.slow
def test_export_takes_the_file(file: Path, start: Run) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    done = start(
        "uncal.export",
        *(f"weights={file}", "format=onnx", "out=mine.onnx", "image_size=[48,128]"),
        cwd=file.parent,
    )
    assert done.returncode == 0, done.stderr
    session = onnxruntime.InferenceSession(file.with_name("mine.onnx"))
    # Only the level that ten drives allow.
    assert session.get_outputs()[1].shape == [1, 6]


@pytest.mark.slow
def test_a_first_extrinsic_is_found_from_a_guess(own_rig: Path, start: Run) -> None:
    folder = own_rig.parent / "guessed"
    shutil.copytree(own_rig, folder)
    recording = PlainFolder(own_rig)
    T = torch.from_numpy(recording.load(recording.frame_ids[0]).T_cam_lidar)
    off = torch.tensor([0.2, -0.15, 0.1, 0.05, -0.05, 0.06], dtype=torch.float64)
    rig = yaml.safe_load((folder / "rig.yaml").read_text())
    ((camera, lidars),) = rig["extrinsics"].items()
    (lidar,) = lidars
    rig["extrinsics"][camera][lidar] = decalibrate(T, off).tolist()
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    done = start(
        "uncal.calibrate",
        *("weights=unical", f"recordings={folder}", "dataset=folder", "trusted=false"),
        *("out=first.safetensors", "guess.frames=6", "hydra.run.dir=first"),
        cwd=own_rig.parent,
    )
    assert done.returncode == 0, done.stderr
    assert "No reference, no guarantee" in done.stdout
    said = yaml.safe_load((own_rig.parent / "first.transform.yaml").read_text())
    found = [said["transform"]["translation"][axis] for axis in "xyz"]
    assert np.abs(np.array(found) - T[:3, 3].numpy()).max() < 0.1


def test_references_travel_in_the_file_of_weights(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    error, std = rng.normal(size=(9, 2, 6)), np.ones((9, 2, 6))
    rest = rng.normal(size=(9, 2, 3)), rng.normal(size=(9, 4)), rng.normal(size=(3, 6))
    made: dict[str, object] = {"weights": "abc"}
    references = References(made, "tried", [f"d{i}" for i in range(9)], error, std, *rest)
    path = tmp_path / "mine.safetensors"
    save_shipped({"w": torch.ones(2)}, {"seed": 0}, path, {INSIDE: references.packed()})
    found = find_references(path, made)
    assert found is not None
    np.testing.assert_array_equal(found.error, error)
    assert found.drives == references.drives
    with pytest.raises(ConfigurationError, match="made with another estimator"):
        find_references(path, {"weights": "xyz"})
    save_shipped({"w": torch.ones(2)}, {"seed": 0}, path)
    assert find_references(path, made) is None
