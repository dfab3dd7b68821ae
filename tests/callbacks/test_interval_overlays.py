from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
import torch
from lightning import Trainer
from numpy.typing import NDArray
from torch import nn

from uncal.callbacks.interval_overlays import IntervalOverlays, bound_extrinsics, chosen_by_width
from uncal.callbacks.overlays import background
from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.dataset import Sample
from uncal.data.network_input import InputSettings
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES, invert, matrix_to_pose, pose_to_matrix
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.models.estimator import PoseEstimator
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction
from uncal.recordings.kitti import KittiRaw
from uncal.reporting.overlay import overlay_panel
from uncal.splits.split_settings import SplitSettings
from uncal.uncertainty import ConformalCalibrator, MCDropout

RANGE = DecalibrationRange(1.0, 10.0)


def _data(root: Path) -> CalibrationDataModule:
    return CalibrationDataModule(
        recording=KittiRaw(root),
        image_size=(64, 96),
        decalibration=RANGE,
        split=SplitSettings("frame", (0.2, 0.2, 0.2, 0.4), seed=0),
        loader=LoaderSettings(2, 2, 0, False),
        inputs=InputSettings(
            channels=["rgb", "inverse_depth", "intensity"],
            camera_channels=3,
            rgb_mean=0.45,
            rgb_std=0.225,
            inverse_depth_scale=10.0,
            intensity_scale=2.0,
        ),
        augmentation=Augmentation(0.5, 0.1, 0.1),
        seed=5,
    )


def _module(data: CalibrationDataModule) -> CalibrationModule:
    """Tested on all test frames: estimates 0.1° above the truth, σ 0.01°, 0.02°, … in places."""
    module = CalibrationModule(
        estimator=PoseEstimator(
            nn.Sequential(nn.Dropout(0.5)),
            RANGE.bounds,
            ridge=0.1,
            displacement_weight=0.5,
            quantile_levels=(0.05, 0.95),
        ),
        optimizer=lambda parameters: torch.optim.AdamW(parameters),
        warmup_fraction=0.1,
        engine=lambda network, masks: MCDropout(network, 5, masks=masks),
        spread="dropout",
        fixed_masks=False,
        calibrator=ConformalCalibrator(DOF_NAMES),
        groups="rig",
        mask_seed=0,
    )
    frames = data.splits["test"]
    target = torch.stack([RANGE.draw_for(5, str(frame)) for frame in frames])
    sigma = math.radians(0.01) * torch.arange(1.0, len(frames) + 1)
    module.run.tested = SplitPrediction(
        index=torch.arange(len(frames)),
        mean=target + math.radians(0.1),
        std=sigma[:, None].expand(-1, 6),
        target=target,
        covariance=torch.diag_embed(sigma[:, None].expand(-1, 6) ** 2),
    )
    one = torch.ones(9, 6)
    # All scores are 10: bounds 10 σ from the estimate.
    module.calibrator.fit(0 * one, one, 10 * one)
    return module


def _trainer(data: CalibrationDataModule | None, zero: bool = True) -> Trainer:
    return cast(
        Trainer,
        SimpleNamespace(is_global_zero=zero, loggers=[], global_step=0, datamodule=data),
    )


def test_three_pictures_from_widest_to_narrowest(
    kitti_raw_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = _data(kitti_raw_root)
    module = _module(data)
    assert module.run.tested is not None
    n = len(module.run.tested.index)
    assert n >= 3
    asked: list[dict[str, NDArray[np.float64]]] = []

    def spy(
        image: NDArray[np.uint8],
        points: NDArray[np.float32],
        K: NDArray[np.float64],
        extrinsics: Mapping[str, NDArray[np.float64]],
        scale: int,
    ) -> NDArray[np.uint8]:
        asked.append(dict(extrinsics))
        return overlay_panel(image, points, K, extrinsics, scale)

    monkeypatch.setattr("uncal.callbacks.overlays.overlay_panel", spy)
    callback = IntervalOverlays(str(tmp_path / "overlays"), 3, "Pitch", 0.9, "simulated")
    callback.on_test_end(_trainer(data), module)
    names = [
        "interval_pitch_median.png",
        "interval_pitch_narrowest.png",
        "interval_pitch_widest.png",
    ]
    assert sorted(path.name for path in (tmp_path / "overlays").iterdir()) == names
    picture = cv2.imread(str(tmp_path / "overlays" / names[2]))
    assert picture is not None
    assert picture.shape[1] >= 960
    widest = list(asked[0])
    assert widest == [
        f"Pitch at its lower bound: -{0.1 * n:.2f} deg from the estimate",
        f"Pitch as estimated: off by +0.10 deg; widest 90% interval of {n} (simulated), "
        f"{0.2 * n:.2f} deg wide",
        f"Pitch at its upper bound: +{0.1 * n:.2f} deg from the estimate",
    ]
    (sample,) = data.datasets["test"][n - 1]
    assert isinstance(sample, Sample)
    T_true = sample.T_cam_lidar.double()
    T_init = decalibrate(T_true, module.run.tested.target[n - 1].double())
    for caption, pitch in zip(widest, (-0.1 * n, 0.0, 0.1 * n), strict=True):
        pose = matrix_to_pose(invert(torch.from_numpy(asked[0][caption])) @ T_init)
        expected = module.run.tested.mean[n - 1].double()
        expected[4] += math.radians(pitch)
        assert pose.tolist() == pytest.approx(expected.tolist(), abs=1e-6)


def test_a_frame_that_fails_is_named_and_the_others_are_drawn(
    kitti_raw_root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    data = _data(kitti_raw_root)
    calls: list[object] = []

    def fails_once(*arguments: object) -> NDArray[np.uint8]:
        calls.append(arguments)
        if len(calls) == 1:
            raise OSError("the disk is gone")
        return background(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr("uncal.callbacks.overlays.background", fails_once)
    IntervalOverlays(str(tmp_path / "o"), 3, "X", 0.9, "simulated").on_test_end(
        _trainer(data), _module(data)
    )
    assert sorted(path.stem for path in (tmp_path / "o").iterdir()) == [
        "interval_x_median",
        "interval_x_narrowest",
    ]
    (record,) = [record for record in caplog.records if record.levelno == logging.ERROR]
    assert "widest 90% interval" in record.getMessage()
    assert "the disk is gone" in record.getMessage()


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_nothing_is_drawn_without_finite_intervals_or_elsewhere(
    kitti_raw_root: Path, tmp_path: Path
) -> None:
    data = _data(kitti_raw_root)
    folder = tmp_path / "overlays"
    IntervalOverlays(str(folder), 3, "Pitch", 0.99, "simulated").on_test_end(
        _trainer(data), _module(data)
    )
    callback = IntervalOverlays(str(folder), 3, "Pitch", 0.9, "simulated")
    callback.on_test_end(_trainer(data, zero=False), _module(data))
    callback.on_test_end(_trainer(None), _module(data))
    untested = _module(data)
    untested.run.tested = None
    callback.on_test_end(_trainer(data), untested)
    assert not folder.exists()


def test_frames_are_chosen_by_the_rank_of_their_width() -> None:
    width = torch.tensor([3.0, 9.0, 1.0, 7.0, 5.0])
    assert chosen_by_width(width, 3) == {"widest": 1, "median": 4, "narrowest": 2}
    assert chosen_by_width(width, 1) == {"widest": 1}
    assert chosen_by_width(width, 2) == {"widest": 1, "narrowest": 2}
    assert chosen_by_width(width[:2], 3) == {"widest": 1, "narrowest": 0}
    assert list(chosen_by_width(width, 5)) == ["widest", "rank 2", "median", "rank 4", "narrowest"]
    assert chosen_by_width(torch.tensor([torch.inf]), 3) == {}


def test_only_one_dof_is_moved_and_translations_are_centimetres() -> None:
    estimate = torch.tensor([0.02, 0.0, 0.01, 0.001, 0.002, 0.003], dtype=torch.float64)
    T_init = pose_to_matrix(2 * estimate)
    made = bound_extrinsics(T_init, estimate, 0 * estimate, (0.0, 0.05), "X", "this one")
    assert list(made) == [
        "X at its lower bound: -2.0 cm from the estimate",
        "X as estimated: off by +2.0 cm; this one, 5.0 cm wide",
        "X at its upper bound: +3.0 cm from the estimate",
    ]
    for T_estimated, x in zip(made.values(), (0.0, 0.02, 0.05), strict=True):
        pose = matrix_to_pose(invert(torch.from_numpy(T_estimated)) @ T_init)
        assert pose.tolist() == pytest.approx([x, *estimate[1:].tolist()])
    assert all(caption.isascii() for caption in made)


def test_an_unknown_dof_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="choose one of X, Y, Z, Roll, Pitch, Yaw"):
        IntervalOverlays("overlays", 3, "pitch", 0.9, "simulated")
