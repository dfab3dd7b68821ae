from __future__ import annotations

import pytest

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.splits.split_settings import cap_training, hold_out_rigs


def recording(n_rigs: int, n_frames: int = 3) -> list[FrameId]:
    return [
        FrameId(f"rig{rig}", "drive", index) for rig in range(n_rigs) for index in range(n_frames)
    ]


def rigs(frames: list[FrameId]) -> set[str]:
    return {frame.rig for frame in frames}


@pytest.mark.parametrize(
    ("n_rigs", "share", "expected"),
    [(60, 0.2, 12), (10, 0.25, 3), (10, 0.24, 2), (10, 0.01, 1), (2, 0.5, 1), (5, 0.0, 0)],
)
def test_whole_rigs_are_put_away(n_rigs: int, share: float, expected: int) -> None:
    frames = recording(n_rigs)
    kept, away = hold_out_rigs(frames, share, seed=0)
    assert len(rigs(away)) == expected
    assert rigs(kept).isdisjoint(rigs(away))
    assert sorted(map(str, [*kept, *away])) == sorted(map(str, frames))


def test_the_order_of_the_frames_does_not_matter_and_the_seed_does() -> None:
    frames = recording(20)
    _, away = hold_out_rigs(frames, 0.3, seed=1)
    assert hold_out_rigs(frames[::-1], 0.3, seed=1)[1] == away
    assert hold_out_rigs(frames, 0.3, seed=2)[1] != away


def test_known_choices_stay_as_they_are() -> None:
    # A change of these would move test frames of published runs into training.
    _, away = hold_out_rigs(recording(10), 0.3, seed=0)
    assert rigs(away) == {"rig3", "rig4", "rig7"}
    chosen = cap_training([FrameId("rig", "drive", index) for index in range(20)], 6, seed=0)
    assert [frame.index for frame in chosen] == [1, 4, 5, 6, 9, 16]


def test_every_rig_has_its_turn() -> None:
    # 200 seeds, 2 of 5 rigs each: 80 ± 7 turns per rig.
    turns = dict.fromkeys(rigs(recording(5)), 0)
    for seed in range(200):
        for rig in rigs(hold_out_rigs(recording(5, 1), 0.4, seed)[1]):
            turns[rig] += 1
    assert sum(turns.values()) == 400
    assert all(50 < n < 110 for n in turns.values())


@pytest.mark.parametrize("share", [-0.1, 1.0, 12, float("nan")])
def test_a_share_out_of_range(share: float) -> None:
    with pytest.raises(
        ConfigurationError, match=rf"split\.unseen_rigs={share}: .*at least 0 and below 1"
    ):
        hold_out_rigs(recording(60), share, seed=0)


@pytest.mark.parametrize(("n_rigs", "share"), [(1, 0.2), (5, 0.95)])
def test_a_rig_must_remain(n_rigs: int, share: float) -> None:
    with pytest.raises(
        ConfigurationError,
        match=rf"unseen_rigs={share} holds out {n_rigs} of {n_rigs} rig.*smaller share, add",
    ):
        hold_out_rigs(recording(n_rigs), share, seed=0)


def test_exactly_so_many_training_frames() -> None:
    training = recording(10, 10)
    chosen = cap_training(training, 40, seed=0)
    assert len(chosen) == len(set(chosen)) == 40
    assert set(chosen) <= set(training)
    assert chosen == [frame for frame in training if frame in set(chosen)]
    # Drawn at random, 4 ± 1.5 of each rig's 10.
    assert rigs(chosen) == rigs(training)
    assert cap_training(recording(10, 10)[::-1], 40, seed=0) == chosen
    assert cap_training(training, 40, seed=1) != chosen
    assert set(cap_training(training, 20, seed=0)) < set(chosen)
    assert cap_training(training, 100, seed=0) == training


def test_more_training_frames_than_there_are() -> None:
    with pytest.raises(
        ConfigurationError, match=r"train_frames=31, but .* has 30 .*train_frames=30 or less"
    ):
        cap_training(recording(10), 31, seed=0)


@pytest.mark.parametrize("n", [0, -4, 2.5])
def test_a_number_that_is_none(n: int) -> None:
    with pytest.raises(
        ConfigurationError,
        match=rf"split\.train_frames={n}: expected a whole number from 1 .* or null",
    ):
        cap_training(recording(10), n, seed=0)
