from __future__ import annotations

import itertools

import numpy as np
import pytest

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.splits.splits import SPLITS, UNITS, split_frames

PAPER = (0.60, 0.15, 0.15, 0.10)


def recording(n_rigs: int, n_drives: int, n_frames: int) -> list[FrameId]:
    """``n_drives`` drives of each rig; drives of different rigs share their names."""
    return [
        FrameId(f"rig{rig}", f"drive{drive}", index)
        for rig in range(n_rigs)
        for drive in range(n_drives)
        for index in range(n_frames)
    ]


def sizes(splits: dict[str, list[FrameId]]) -> list[int]:
    return [len(splits[name]) for name in SPLITS]


@pytest.mark.parametrize("by", UNITS)
@pytest.mark.parametrize("seed", range(5))
def test_disjoint_and_total(by: str, seed: int) -> None:
    frames = recording(n_rigs=6, n_drives=3, n_frames=7)
    splits = split_frames(frames, by, PAPER, seed, block_frames=3)
    assert tuple(splits) == SPLITS
    together = [frame_id for members in splits.values() for frame_id in members]
    assert len(together) == len(frames)
    assert set(together) == set(frames)


@pytest.mark.parametrize("by", ["drive", "rig"])
def test_groups_stay_whole(by: str) -> None:
    splits = split_frames(recording(6, 3, 7), by, PAPER, seed=1)
    groups = [
        {(f.rig, f.drive) if by == "drive" else (f.rig,) for f in members}
        for members in splits.values()
    ]
    assert all(groups)
    for one, other in itertools.combinations(groups, 2):
        assert one.isdisjoint(other)


@pytest.mark.parametrize("by", UNITS)
def test_depends_on_the_seed_and_not_on_the_order(by: str) -> None:
    frames = recording(12, 2, 5)
    shuffled = [frames[i] for i in np.random.default_rng(0).permutation(len(frames))]
    splits = split_frames(frames, by, PAPER, seed=3, block_frames=2)
    assert split_frames(shuffled, by, PAPER, seed=3, block_frames=2) == splits
    assert split_frames(frames, by, PAPER, seed=4, block_frames=2) != splits


@pytest.mark.parametrize("seed", range(10))
def test_blocks_stay_whole_and_drives_are_torn_apart(seed: int) -> None:
    # Drives of 23 frames and blocks of 5: 0-4, 5-9, 10-14, 15-19, 20-22.
    splits = split_frames(recording(4, 2, 23), "block", PAPER, seed, block_frames=5)
    split_of = {frame: name for name, frames in splits.items() for frame in frames}
    torn = 0
    for rig, drive in itertools.product(range(4), range(2)):
        numbered = [FrameId(f"rig{rig}", f"drive{drive}", index) for index in range(23)]
        of_blocks = [
            {split_of[f] for f in numbered[first : first + 5]} for first in range(0, 23, 5)
        ]
        assert all(len(names) == 1 for names in of_blocks)
        torn += len(set.union(*of_blocks)) > 1
    assert torn > 4
    assert min(sizes(splits)) >= 3


def test_a_known_split_stays_as_it_is() -> None:
    # A change of this result would move test frames of published runs into training.
    splits = split_frames(recording(8, 1, 3), "rig", PAPER, seed=0)
    rigs = {name: sorted({f.rig for f in members}) for name, members in splits.items()}
    assert rigs == {
        "train": ["rig1", "rig3", "rig4", "rig6", "rig7"],
        "validation": ["rig2"],
        "uncertainty_calibration": ["rig0"],
        "test": ["rig5"],
    }


def test_a_known_split_into_blocks_stays_as_it_is() -> None:
    frames = [FrameId("rig", "drive", index) for index in range(40)]
    splits = split_frames(frames, "block", PAPER, seed=0, block_frames=4)
    blocks = {name: sorted({f.index // 4 for f in members}) for name, members in splits.items()}
    assert blocks == {
        "train": [0, 1, 3, 4, 6, 9],
        "validation": [5, 8],
        "uncertainty_calibration": [7],
        "test": [2],
    }


@pytest.mark.parametrize(
    ("n", "expected"),
    [
        (40, [24, 6, 6, 4]),
        (100, [60, 15, 15, 10]),
        # 4.2, 1.05, 1.05, 0.7: the largest remainder is the test split's.
        (7, [4, 1, 1, 1]),
        # 13.8, 3.45, 3.45, 2.3: one left for .8, one for the first of the two .45.
        (23, [14, 4, 3, 2]),
        # 2.4, 0.6, 0.6, 0.4 would leave the test split empty.
        (4, [1, 1, 1, 1]),
    ],
)
def test_frames_are_rounded_by_largest_remainder(n: int, expected: list[int]) -> None:
    assert sizes(split_frames(recording(1, 1, n), "frame", PAPER, seed=0)) == expected


@pytest.mark.parametrize("seed", range(20))
def test_uneven_groups_approach_the_fractions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_frames = rng.integers(20, 200, size=60)
    frames = [
        FrameId(f"rig{rig}", "drive", index) for rig, n in enumerate(n_frames) for index in range(n)
    ]
    shares = np.array(sizes(split_frames(frames, "rig", PAPER, seed))) / len(frames)
    # A split takes a group only while it lacks frames, so none exceeds its share by a whole group.
    assert (shares - PAPER).max() < n_frames.max() / len(frames)
    assert np.abs(shares - PAPER).max() < 0.03


@pytest.mark.parametrize("seed", range(5))
def test_every_split_gets_a_group_however_large_the_first(seed: int) -> None:
    frames = [FrameId("large", "drive", index) for index in range(1000)]
    frames += recording(3, 1, 2)
    splits = split_frames(frames, "rig", PAPER, seed)
    assert min(sizes(splits)) > 0


def test_an_unused_split_needs_no_group() -> None:
    splits = split_frames(recording(3, 1, 4), "rig", (0.5, 0.25, 0.25, 0.0), seed=0)
    assert sizes(splits) == [4, 4, 4, 0]


def test_shuffles_frames() -> None:
    train = split_frames(recording(1, 1, 100), "frame", PAPER, seed=0)["train"]
    # 60 of 100 drawn at random: 30 ± 3.5 of the first half.
    assert 18 <= sum(frame_id.index < 50 for frame_id in train) <= 42
    assert [frame_id.index for frame_id in train] == sorted(frame_id.index for frame_id in train)


def test_too_few_groups_names_their_number_and_the_remedy() -> None:
    with pytest.raises(
        ConfigurationError, match=r"at least 4 rigs.* there are 1 \(rig0\): use split.by=frame"
    ):
        split_frames(recording(1, 5, 5), "rig", PAPER, seed=0)
    with pytest.raises(ConfigurationError, match=r"there are 3 .*: add frames"):
        split_frames(recording(1, 1, 3), "frame", PAPER, seed=0)
    with pytest.raises(ConfigurationError, match=r"there are 0 \(none\)"):
        split_frames([], "frame", PAPER, seed=0)
    with pytest.raises(
        ConfigurationError, match=r"there are 2 \(rig0/drive0/block000.*lower split"
    ):
        split_frames(recording(1, 1, 40), "block", PAPER, seed=0, block_frames=20)


@pytest.mark.parametrize(
    ("fractions", "message"),
    [
        ((0.6, 0.2, 0.2), "expected a list of 4"),
        ((0.6, 0.15, 0.15, 0.2), "that sum to 1"),
        ((0.8, 0.3, -0.1, 0.0), "each a number from 0 to 1"),
        ((0.6, 0.3, float("nan"), 0.1), "each a number from 0 to 1"),
    ],
)
def test_fractions_out_of_range(fractions: tuple[float, ...], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        split_frames(recording(1, 1, 40), "frame", fractions, seed=0)


def test_unknown_unit() -> None:
    with pytest.raises(
        ConfigurationError, match=r"split\.by='rigs': expected frame or block or drive or rig"
    ):
        split_frames(recording(4, 1, 1), "rigs", PAPER, seed=0)


def test_a_frame_that_comes_twice_is_refused() -> None:
    frames = recording(1, 1, 40)
    with pytest.raises(ValueError, match="comes twice"):
        split_frames([*frames, frames[3]], "frame", PAPER, seed=0)
