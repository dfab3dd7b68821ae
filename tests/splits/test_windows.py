"""Windows of frames: whole, apart from other splits, and shorter where a frame cannot be read."""

import itertools

import numpy as np
import pytest
import torch

from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.network_input import InputSettings
from uncal.errors import ConfigurationError, FrameError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.frame import Frame, FrameId
from uncal.splits.split_settings import SplitSettings
from uncal.splits.splits import SPLITS, by_name
from uncal.splits.windows import Unit, WindowSettings, units_of

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
K = np.array([[40.0, 0.0, 23.5], [0.0, 40.0, 15.5], [0.0, 0.0, 1.0]])
T = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
FRACTIONS = (0.4, 0.2, 0.2, 0.2)


class Street:
    """Drives of several rigs, numbered with gaps; some frames cannot be read."""

    skipped: dict[str, str]

    def __init__(self, rigs: int = 5, drives: int = 2, frames: int = 24) -> None:
        self.frame_ids = [
            FrameId(f"rig{rig}", f"drive{drive}", 3 * index)
            for rig in range(rigs)
            for drive in range(drives)
            for index in range(frames)
        ]
        self.skipped = {}
        self.unreadable: set[FrameId] = set()

    def load(self, frame_id: FrameId) -> Frame:
        if frame_id in self.unreadable:
            raise FrameError("truncated")
        rng = np.random.default_rng(frame_id.index)
        points = rng.uniform([4, -3, -2, 0], [30, 3, 2, 1], (200, 4)).astype(np.float32)
        image = rng.integers(0, 256, (32, 48, 3), dtype=np.uint8)
        return Frame(frame_id, image, points, K, T, 0.0)


def data_of(
    street: Street, split: SplitSettings, window: int, eval_batch: int = 8
) -> CalibrationDataModule:
    return CalibrationDataModule(
        recording=street,
        image_size=(32, 48),
        decalibration=RANGE,
        split=split,
        loader=LoaderSettings(batch_size=4, eval_batch_size=eval_batch, workers=0, cache=False),
        inputs=InputSettings(
            channels=["rgb", "inverse_depth", "intensity"],
            inverse_depth_scale=10.0,
            intensity_scale=2.0,
            edges=30,
        ),
        augmentation=Augmentation(mirror=0.5, brightness=0.1, contrast=0.1),
        seed=5,
        window=WindowSettings(window),
    )


def spans(unit: Unit, everything: list[FrameId]) -> list[FrameId]:
    """All frames of the recording from a window's first to its last."""
    number = {frame: i for i, frame in enumerate(sorted(everything, key=by_name))}
    first, last = number[unit[0]], number[unit[-1]]
    return sorted(everything, key=by_name)[first : last + 1]


@pytest.mark.parametrize("frames", [24, 22, 21, 13])
@pytest.mark.parametrize(
    "split",
    [
        SplitSettings("frame", FRACTIONS, seed=0),
        SplitSettings("block", FRACTIONS, seed=0, block_frames=8),
        SplitSettings("block", FRACTIONS, seed=1, block_frames=8, block_gap=2),
        SplitSettings("block", FRACTIONS, seed=2, block_frames=12, block_gap=3),
        SplitSettings("drive", FRACTIONS, seed=0),
        SplitSettings("rig", FRACTIONS, seed=0),
    ],
    ids=lambda split: f"{split.by}{split.block_gap or ''}",
)
def test_no_window_reaches_into_another_split(split: SplitSettings, frames: int) -> None:
    street = Street(frames=frames)
    data = data_of(street, split, window=4)
    owner = {frame: name for name in SPLITS for frame in data.splits[name]}
    for name in ("uncertainty_calibration", "test"):
        units = data.units[name]
        assert [frame for unit in units for frame in unit] == data.splits[name]
        assert max(map(len, units)) >= 4
        for unit in units:
            assert len({(frame.rig, frame.drive) for frame in unit}) == 1
            for frame in spans(unit, street.frame_ids):
                assert owner.get(frame) == name
            # Shorter than half a window only where there are no more frames beside it.
            assert len(unit) <= 5
    for name in ("train", "validation"):
        assert all(len(unit) == 1 for unit in data.units[name])
    for one, other in itertools.combinations(SPLITS, 2):
        assert not set(data.splits[one]) & set(data.splits[other])


def test_a_window_ends_where_frames_of_the_recording_are_missing() -> None:
    whole = [FrameId("rig", "drive", index) for index in range(12)]
    mine = whole[:3] + whole[6:]
    assert [[f.index for f in unit] for unit in units_of(mine, 4)] == [
        [0, 1, 2, 6],
        [7, 8, 9, 10, 11],
    ]
    assert [[f.index for f in unit] for unit in units_of(mine, 4, whole)] == [
        [0, 1, 2],
        [6, 7, 8, 9],
        [10, 11],
    ]


def test_blocks_that_would_cut_windows_are_refused() -> None:
    split = SplitSettings("block", FRACTIONS, seed=0, block_frames=6)
    with pytest.raises(ConfigurationError, match=r"multiple of window\.frames=4"):
        data_of(Street(), split, window=4)


@pytest.mark.parametrize("frames", [0, -1, 2.0, True, "4"])
def test_windows_have_a_whole_number_of_frames(frames: object) -> None:
    with pytest.raises(ConfigurationError, match=r"window\.frames"):
        WindowSettings(frames)  # type: ignore[arg-type]


def test_frames_of_a_window_share_a_decalibration_and_stay_together() -> None:
    data = data_of(Street(), SplitSettings("drive", FRACTIONS, seed=0), window=4)
    names = data.named("test")
    seen = 0
    for batch in data.loader_of("test"):
        # As many frames as eval_batch_size says: two windows.
        assert len(batch.unit_index) == 2
        assert batch.unit.tolist() == [0] * 4 + [1] * 4
        inputs = data.on_after_batch_transfer(batch, 0)
        assert inputs is not None
        assert inputs.target.shape == (2, 6)
        for row, index in enumerate(batch.unit_index.tolist()):
            assert torch.equal(inputs.target[row], RANGE.draw_for(5, str(names[index])))
        # One extrinsic in this recording: frames of a window start from the same wrong one.
        for row in range(2):
            mine = inputs.T_init[inputs.unit == row]
            torch.testing.assert_close(mine, mine[:1].expand(4, 4, 4))
        assert not torch.equal(inputs.T_init[0], inputs.T_init[4])
        seen += len(batch.unit_index)
    assert seen == len(names) == len(data.splits["test"]) // 4


def test_a_frame_that_cannot_be_read_shortens_its_window_and_is_reported() -> None:
    street = Street()
    data = data_of(street, SplitSettings("drive", FRACTIONS, seed=0), window=4)
    first, second = data.units["test"][:2]
    whole = next(iter(data.loader_of("test")))
    street.unreadable = {first[0], second[2]}
    batch = next(iter(data.loader_of("test")))
    assert batch.unit.tolist() == [0] * 3 + [1] * 3
    assert batch.unit_index.tolist() == [0, 1]
    assert batch.frames == [*first[1:], second[0], second[1], second[3]]
    # The window's own, although the frame that names it is not there.
    assert batch.decalibration is not None
    assert whole.decalibration is not None
    assert torch.equal(batch.decalibration, whole.decalibration)
    data.on_after_batch_transfer(batch, 0)
    assert data.skipped == {str(first[0]): "truncated", str(second[2]): "truncated"}


def test_a_window_without_a_readable_frame_is_left_out() -> None:
    street = Street()
    data = data_of(street, SplitSettings("drive", FRACTIONS, seed=0), window=4)
    first, second = data.units["test"][:2]
    street.unreadable = set(first)
    batch = next(iter(data.loader_of("test")))
    assert batch.unit_index.tolist() == [1]
    assert batch.unit.tolist() == [0] * 4
    assert batch.frames == list(second)
    assert len(batch.skipped) == 4


def test_windows_larger_than_a_batch_are_loaded_one_by_one() -> None:
    split = SplitSettings("drive", FRACTIONS, seed=0)
    data = data_of(Street(), split, window=12, eval_batch=8)
    assert {len(batch.frames) for batch in data.loader_of("test")} == {12}
