"""One walk over a recording gives the batches of a split, and every frame."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
import torch

from uncal.calibrating.walk import batches_of_one_walk
from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.dataset import Batch
from uncal.data.network_input import InputSettings
from uncal.errors import FrameError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.kitti import KittiRaw
from uncal.splits.split_settings import SplitSettings
from uncal.splits.windows import WindowSettings

INPUTS = InputSettings(
    channels=["rgb", "inverse_depth", "intensity"],
    camera_channels=3,
    rgb_mean=0.45,
    rgb_std=0.225,
    inverse_depth_scale=10.0,
    intensity_scale=2.0,
    edges=50,
)
SPLIT = "uncertainty_calibration"
DAMAGED = 3


class Counted(KittiRaw):
    """Counts how often each frame is read; one of them cannot be."""

    def load(self, frame_id: FrameId) -> Frame:
        self.__dict__.setdefault("reads", Counter())[str(frame_id)] += 1
        if frame_id == self.frame_ids[DAMAGED]:
            raise FrameError("damaged")
        return super().load(frame_id)


def data_of(root: Path, window: int, workers: int) -> CalibrationDataModule:
    return CalibrationDataModule(
        recording=Counted(root),
        image_size=(24, 80),
        decalibration=DecalibrationRange(1.0, 10.0),
        split=SplitSettings("frame", (0.0, 0.0, 0.7, 0.3), seed=0),
        loader=LoaderSettings(batch_size=2, eval_batch_size=2, workers=workers, cache=False),
        inputs=INPUTS,
        augmentation=Augmentation(mirror=0.0, brightness=0.0, contrast=0.0),
        seed=5,
        window=WindowSettings(window),
    )


def same(one: Batch, other: Batch) -> bool:
    tensors = [value for value in one if isinstance(value, torch.Tensor)]
    others = [value for value in other if isinstance(value, torch.Tensor)]
    equal = all(
        torch.equal(a.nan_to_num(-1), b.nan_to_num(-1))
        for a, b in zip(tensors, others, strict=True)
    )
    return equal and one.frames == other.frames and one.skipped == other.skipped


@pytest.mark.parametrize(("window", "workers"), [(1, 0), (2, 0), (1, 1)])
def test_the_batches_are_those_of_the_loader(
    kitti_raw_root: Path, window: int, workers: int
) -> None:
    data = data_of(kitti_raw_root, window, workers)
    expected = list(data_of(kitti_raw_root, window, 0).loader_of(SPLIT))
    assert len(expected) > 1
    seen: list[tuple[FrameId, Frame | FrameError]] = []
    found = list(batches_of_one_walk(data, SPLIT, lambda *frame: seen.append(frame), "walk"))
    assert len(found) == len(expected)
    assert all(same(one, other) for one, other in zip(found, expected, strict=True))
    assert [frame_id for frame_id, _ in seen] == data.recording.frame_ids
    for number, (frame_id, frame) in enumerate(seen):
        if number == DAMAGED:
            assert isinstance(frame, FrameError)
        else:
            assert isinstance(frame, Frame)
            assert frame.id == frame_id
    if not workers:
        reads = data.recording.__dict__["reads"]
        assert reads == dict.fromkeys(map(str, data.recording.frame_ids), 1)
