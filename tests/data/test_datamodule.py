from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.dataset import Sample, SkippedFrame, collate
from uncal.data.network_input import InputSettings, NetworkInput
from uncal.geometry.decalibration import DecalibrationRange
from uncal.geometry.projection import project
from uncal.recordings.kitti import KittiRaw
from uncal.splits.split_settings import SplitSettings
from uncal.splits.splits import SPLITS

INPUTS = InputSettings(
    channels=["rgb", "inverse_depth", "intensity"],
    camera_channels=3,
    rgb_mean=0.45,
    rgb_std=0.225,
    inverse_depth_scale=10.0,
    intensity_scale=2.0,
)


def data_module(root: Path, **loader: int | bool) -> CalibrationDataModule:
    settings = {"batch_size": 2, "eval_batch_size": 2, "workers": 0, "cache": False} | loader
    return CalibrationDataModule(
        recording=KittiRaw(root),
        image_size=(64, 96),
        decalibration=DecalibrationRange(1.0, 10.0),
        split=SplitSettings("frame", (0.4, 0.2, 0.2, 0.2), seed=0),
        loader=LoaderSettings(**settings),  # type: ignore[arg-type]
        inputs=INPUTS,
        augmentation=Augmentation(mirror=0.5, brightness=0.1, contrast=0.1),
        seed=5,
    )


def inputs_of(data: CalibrationDataModule, split: str) -> list[NetworkInput]:
    made = [data.on_after_batch_transfer(batch, 0) for batch in data.loader_of(split)]
    return [inputs for inputs in made if inputs is not None]


def targets(data: CalibrationDataModule, split: str) -> Tensor:
    return torch.cat([inputs.target for inputs in inputs_of(data, split)])


def test_splits_are_disjoint_and_total(kitti_raw_root: Path) -> None:
    data = data_module(kitti_raw_root)
    frames = [frame for name in SPLITS for frame in data.splits[name]]
    assert len(frames) == len(set(frames)) == len(data.recording.frame_ids)


def test_evaluation_draws_repeat_and_training_draws_do_not(kitti_raw_root: Path) -> None:
    data, again = data_module(kitti_raw_root), data_module(kitti_raw_root)
    for split in SPLITS[1:]:
        assert torch.equal(targets(data, split), targets(again, split))
    assert not torch.equal(targets(data, "train"), targets(data, "train"))


def test_the_input_is_the_decalibrated_projection(kitti_raw_root: Path) -> None:
    data = data_module(kitti_raw_root)
    batch = next(iter(data.loader_of("test")))
    inputs = data.on_after_batch_transfer(batch, 0)
    assert inputs is not None
    assert inputs.x.shape == (len(batch.frames), INPUTS.n_channels, 64, 96)
    seen = project(batch.points, inputs.T_init, batch.K, (64, 96))
    assert torch.equal(inputs.inverse_depth, seen.inverse_depth)
    assert torch.equal(inputs.x[:, 3:4], seen.inverse_depth * 10.0)
    assert torch.equal(inputs.x[:, 4:], seen.intensity * 2.0)


def test_culling_leaves_the_projection_of_every_decalibration_unchanged(
    kitti_raw_root: Path,
) -> None:
    data = data_module(kitti_raw_root)
    bounds = data.decalibration.bounds
    for split in SPLITS:
        dataset = data.datasets[split]
        for i, (frame_id,) in enumerate(dataset.units):
            (sample,) = dataset[i]
            assert isinstance(sample, Sample)
            whole = torch.from_numpy(data.recording.load(frame_id).points)[None]
            assert sample.points.shape[0] < whole.shape[1]
            for corner in torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 6)[::5]:
                from uncal.geometry.decalibration import decalibrate

                T = decalibrate(sample.T_cam_lidar, corner * bounds)[None]
                culled = project(sample.points[None], T, sample.K[None], (64, 96))
                full = project(whole, T, sample.K[None], (64, 96))
                assert torch.equal(culled.inverse_depth, full.inverse_depth)
                assert torch.equal(culled.intensity, full.intensity)


def test_a_truncated_scan_is_skipped_counted_and_named(kitti_raw_root: Path) -> None:
    data = data_module(kitti_raw_root)
    victim = data.splits["test"][0]
    scan = next(
        path
        for path in kitti_raw_root.rglob(f"{victim.drive}/velodyne_points/data/*.bin")
        if path.stem == f"{victim.index:010d}"
    )
    scan.write_bytes(scan.read_bytes()[:-5])
    n = sum(len(inputs.x) for inputs in inputs_of(data, "test"))
    assert n == len(data.splits["test"]) - 1
    assert list(data.skipped) == [str(victim)]
    assert scan.name in data.skipped[str(victim)]


def test_a_batch_without_a_readable_frame_is_none(kitti_raw_root: Path) -> None:
    data = data_module(kitti_raw_root)
    victim = data.splits["test"][0]
    empty = collate([[SkippedFrame(victim, "unreadable")]])
    assert data.on_after_batch_transfer(empty, 0) is None
    assert data.skipped == {str(victim): "unreadable"}


def test_workers_and_cache_change_nothing(kitti_raw_root: Path) -> None:
    plain = inputs_of(data_module(kitti_raw_root), "validation")
    cached = data_module(kitti_raw_root, cache=True)
    inputs_of(cached, "validation")
    for other in (
        inputs_of(cached, "validation"),
        inputs_of(data_module(kitti_raw_root, workers=1), "validation"),
    ):
        for a, b in zip(plain, other, strict=True):
            assert torch.equal(a.x, b.x)


def test_a_limited_loader_spreads_over_the_split(kitti_raw_root: Path) -> None:
    data = data_module(kitti_raw_root)
    train = data.splits["train"]
    frames = [frame for batch in data.loader_of("train", 2) for frame in batch.frames]
    assert sorted(map(str, frames)) == sorted(map(str, [train[0], train[len(train) // 2]]))


def test_images_of_two_sizes_and_numbers_from_4391_share_a_batch(kitti_raw_root: Path) -> None:
    """As KITTI's days do: 1242×375 and 1226×370."""
    other = kitti_raw_root / "2011_09_28"
    calibration = other / "calib_cam_to_cam.txt"
    kept = [line for line in calibration.read_text().splitlines() if "S_rect" not in line]
    calibration.write_text("\n".join([*kept, "S_rect_02: 1226.0 370.0"]) + "\n")
    drive = other / "2011_09_28_drive_0005_sync"
    for index in range(2):
        for folder, suffix in (("image_02", ".png"), ("velodyne_points", ".bin")):
            path = drive / folder / "data" / f"{index:010d}{suffix}"
            path = path.rename(path.with_stem(f"{index + 4391:010d}"))
        image = drive / "image_02" / "data" / f"{index + 4391:010d}.png"
        cv2.imwrite(str(image), np.full((370, 1226, 3), 90, np.uint8))
    data = data_module(kitti_raw_root)
    assert not data.skipped
    frames = [frame for frame in data.recording.frame_ids if frame.index < 1 or frame.index > 4000]
    assert [frame.index for frame in frames] == [0, 0, 4391, 4392]
    dataset = data._dataset("test")
    dataset.units = [(frame,) for frame in frames]
    batch = collate([dataset[i] for i in range(4)])
    assert not batch.skipped
    assert batch.camera.shape == (4, 3, 64, 96)
    # The focal length follows each image's own scale.
    scales = [float(focal) / 46.0 for focal in batch.K[:, 0, 0]]
    assert scales[:2] == pytest.approx([64 / 24] * 2, rel=5e-3)
    assert scales[2:] == pytest.approx([64 / 370] * 2, rel=5e-3)
