from __future__ import annotations

import pytest

from uncal.errors import ConfigurationError
from uncal.recordings.dsec_layout import TEST, TRAIN, drive_of
from uncal.splits.sequence_split import paper_split


def test_official_lists() -> None:
    assert (len(TRAIN), len(TEST), len({*TRAIN, *TEST})) == (41, 12, 53)
    assert {"thun_00_a", "interlaken_00_g", "zurich_city_09_e", "zurich_city_11_c"} <= set(TRAIN)
    assert {"thun_01_b", "interlaken_00_b", "zurich_city_14_c", "zurich_city_15_a"} <= set(TEST)


def test_drive_of_names_without_a_letter() -> None:
    assert [drive_of(name) for name in ("sim_00_b", "sim_00", "a")] == ["sim_00", "sim_00", "a"]


def test_official_test_sequences_test() -> None:
    test, note = paper_split([*TRAIN, *TEST], held_out=0.15, seed=0)
    assert test == tuple(sorted(TEST))
    assert "12 official test sequence(s)" in note
    assert "drive(s) interlaken_00, other parts are in training" in note


def test_only_sequences_with_lidar_take_part() -> None:
    test, note = paper_split(["thun_01_b", "zurich_city_04_a"], held_out=0.15, seed=0)
    assert test == ("thun_01_b",)
    assert "in training" not in note


@pytest.mark.parametrize("seed", range(5))
def test_without_test_sequences_whole_drives_are_held_out(seed: int) -> None:
    test, note = paper_split(TRAIN, held_out=0.15, seed=seed)
    assert set(test) < set(TRAIN)
    assert not set(map(drive_of, set(TRAIN) - set(test))) & set(map(drive_of, test))
    assert 0.15 * 41 <= len(test) <= 0.15 * 41 + 6
    assert "whole drive(s) held out of the training ones (" in note
    assert all(drive_of(name) in note for name in test)


def test_held_out_drives_depend_on_the_seed_and_not_on_the_order() -> None:
    held = {paper_split(TRAIN, 0.15, seed)[0] for seed in range(5)}
    assert len(held) > 1
    assert paper_split(TRAIN[::-1], 0.15, 3) == paper_split(TRAIN, 0.15, 3)


def test_a_drive_is_always_left_to_train_on() -> None:
    test, _ = paper_split(["sim_00_a", "sim_01_a"], held_out=0.99, seed=0)
    assert len(test) == 1


def test_too_little_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="all of the drive sim_00"):
        paper_split(["sim_00_a", "sim_00_b"], held_out=0.15, seed=0)
    with pytest.raises(ConfigurationError, match="No training sequence among thun_01_a"):
        paper_split(["thun_01_a"], held_out=0.15, seed=0)
    with pytest.raises(ConfigurationError, match="held_out=1: expected"):
        paper_split(TRAIN, held_out=1, seed=0)
