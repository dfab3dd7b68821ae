from __future__ import annotations

import numpy as np
import pytest

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.splits.splits import blocks, leave_gaps, split_frames


def drive(indices: list[int], name: str = "drive", rig: str = "rig") -> list[FrameId]:
    return [FrameId(rig, name, index) for index in indices]


def lengths(n_frames: int, length: int) -> list[int]:
    return [len(frames) for frames in blocks(drive(list(range(n_frames))), length).values()]


@pytest.mark.parametrize(
    ("n_frames", "length", "expected"),
    [
        (60, 20, [20, 20, 20]),
        # Half a block stands alone, less joins the one before.
        (50, 20, [20, 20, 10]),
        (49, 20, [20, 29]),
        (41, 20, [20, 21]),
        # A drive shorter than half a block has none before.
        (3, 20, [3]),
        (23, 20, [23]),
        # 2 of 5 are less than half, 3 are more.
        (12, 5, [5, 7]),
        (13, 5, [5, 5, 3]),
        (4, 1, [1, 1, 1, 1]),
    ],
)
def test_remainders(n_frames: int, length: int, expected: list[int]) -> None:
    assert lengths(n_frames, length) == expected


def test_frames_count_by_position_not_by_number() -> None:
    cut = blocks(drive([7, 0, 2, 100, 9, 1]), 3)
    assert {name: [frame.index for frame in frames] for name, frames in cut.items()} == {
        "rig/drive/block000": [0, 1, 2],
        "rig/drive/block001": [7, 9, 100],
    }


def test_drives_of_one_name_on_two_rigs_are_two() -> None:
    cut = blocks([*drive([0, 1], rig="a"), *drive([0, 1], rig="b")], 4)
    assert list(cut) == ["a/drive/block000", "b/drive/block000"]


@pytest.mark.parametrize("length", [None, 0, -3, 2.5])
def test_a_length_that_is_none(length: int | None) -> None:
    with pytest.raises(ConfigurationError, match=rf"split\.block_frames={length}: expected"):
        blocks(drive([0, 1]), length)


def test_a_gap_is_left_where_blocks_of_different_splits_meet() -> None:
    # Blocks of 4: train 0-3 and 4-7, test 8-11, train 12-15; the boundary at 4 needs no gap.
    frames = drive(list(range(16)))
    other = drive([0, 1, 2, 3], name="other")
    splits = {"train": [*frames[:8], *frames[12:]], "test": [*frames[8:12], *other]}
    left = leave_gaps(splits, 4, 1)
    assert [frame.index for frame in left["train"]] == [0, 1, 2, 3, 4, 5, 6, 12, 13, 14, 15]
    assert left["test"] == [*frames[8:11], *other]


def test_no_gap_changes_nothing() -> None:
    splits = {"train": drive([0, 1, 2]), "test": drive([3, 4, 5])}
    assert leave_gaps(splits, 3, 0) == splits


@pytest.mark.parametrize("seed", range(10))
def test_frames_of_different_splits_are_further_apart_than_the_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [
        frame
        for name in ("a", "b", "c")
        for frame in drive(list(range(rng.integers(30, 90))), name)
    ]
    gap = 3
    whole = split_frames(frames, "block", (0.6, 0.15, 0.15, 0.1), seed, block_frames=8)
    left = leave_gaps(whole, 8, gap)
    split_of = {frame: name for name, members in left.items() for frame in members}
    for frame, name in split_of.items():
        for step in range(1, gap + 1):
            near = FrameId(frame.rig, frame.drive, frame.index + step)
            assert split_of.get(near, name) == name
    # What is left out ends a block: 3 frames at each meeting, nothing else.
    lost = set(frames) - set(split_of)
    assert lost
    assert len(lost) % gap == 0
    assert all(set(left[name]) <= set(whole[name]) for name in whole)


@pytest.mark.parametrize(("gap", "length"), [(-1, 20), (10, 20), (1, 2), (1.5, 20)])
def test_a_gap_that_could_take_a_whole_block(gap: int, length: int) -> None:
    with pytest.raises(ConfigurationError, match=rf"split\.block_gap={gap}: .*half a block.*raise"):
        leave_gaps({"train": drive([0, 1, 2])}, length, gap)
