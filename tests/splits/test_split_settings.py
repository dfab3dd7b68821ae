from __future__ import annotations

from dataclasses import replace

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.settings.configuration import CONFIG_DIR
from uncal.splits.sequence_split import FrameSplit, OfficialSettings
from uncal.splits.split_settings import SplitSettings
from uncal.splits.splits import SPLITS, UNITS, split_frames

PAPER = (0.60, 0.15, 0.15, 0.10)
OFFICIAL = OfficialSettings((0.70, 0.15, 0.15), held_out=0.15)
UNSEEN = SplitSettings("rig", PAPER, 0, block_frames=4, unseen_rigs=0.2, test="unseen")

# 20 rigs × 2 drives × 12 frames: 4 rigs (96 frames) away, 16 rigs (384 frames) remain.
FRAMES = [
    FrameId(f"rig{rig:02d}", f"drive{drive}", index)
    for rig in range(20)
    for drive in range(2)
    for index in range(12)
]
SEQUENCES = [
    FrameId("rig", name, index) for name in ("zurich_city_04_a", "thun_01_a") for index in range(40)
]


def rigs(split: FrameSplit, *names: str) -> set[str]:
    return {frame.rig for name in names for frame in split.frames[name]}


@pytest.mark.parametrize("by", UNITS)
@pytest.mark.parametrize("seed", range(3))
def test_who_tests_changes_nothing_else(by: str, seed: int) -> None:
    settings = replace(UNSEEN, by=by, seed=seed, train_frames=150, block_gap=1)
    unseen, own = settings.split(FRAMES), replace(settings, test="own").split(FRAMES)
    for name in SPLITS[:3]:
        assert unseen.frames[name] == own.frames[name]
    assert set(unseen.frames["test"]).isdisjoint(own.frames["test"])
    assert rigs(unseen, "test").isdisjoint(rigs(own, *SPLITS))


@pytest.mark.parametrize("seed", range(3))
def test_the_same_rigs_are_put_away_whatever_the_split_is_by(seed: int) -> None:
    tests = [replace(UNSEEN, by=by, seed=seed).split(FRAMES).frames["test"] for by in UNITS]
    assert len(tests[0]) == 4 * 2 * 12
    assert all(test == tests[0] for test in tests)


@pytest.mark.parametrize("by", UNITS)
@pytest.mark.parametrize("seed", range(3))
def test_disjoint_and_nothing_is_lost_but_rigs_put_away(by: str, seed: int) -> None:
    split = replace(UNSEEN, by=by, seed=seed, test="own").split(FRAMES)
    together = [frame for name in SPLITS for frame in split.frames[name]]
    assert len(together) == len(set(together)) == 16 * 2 * 12
    away = replace(UNSEEN, by=by, seed=seed).split(FRAMES).frames["test"]
    assert set(together) | set(away) == set(FRAMES)


@pytest.mark.parametrize("by", UNITS)
def test_every_split_trains_on_the_same_number(by: str) -> None:
    whole = replace(UNSEEN, by=by).split(FRAMES)
    capped = replace(UNSEEN, by=by, train_frames=190).split(FRAMES)
    assert len(capped.frames["train"]) == 190
    assert set(capped.frames["train"]) < set(whole.frames["train"])
    assert all(capped.frames[name] == whole.frames[name] for name in SPLITS[1:])
    assert f"190 of {len(whole.frames['train'])} frames (split.train_frames)" in capped.note


def test_settings_left_alone_split_as_before_them() -> None:
    split = SplitSettings("drive", PAPER, seed=3).split(FRAMES)
    assert split == FrameSplit(split_frames(FRAMES, "drive", PAPER, 3), "")


def test_notes_say_what_was_done_and_what_the_guarantee_is_worth() -> None:
    by_rig, by_drive = UNSEEN.split(FRAMES), replace(UNSEEN, by="drive").split(FRAMES)
    said = "The test frames are those of 4 rig(s) held out before the split (split.test=unseen)."
    assert by_rig.note == said
    assert by_drive.note.startswith(said)
    assert "on rigs that training has seen" in by_drive.note
    own = replace(UNSEEN, test="own").split(FRAMES)
    assert "4 rig(s) (96 frames) were held out before the split and are not used" in own.note


def test_notes_of_blocks() -> None:
    blocks = SplitSettings("block", PAPER, 0, block_frames=4)
    assert blocks.split(FRAMES).note == "A block is 4 consecutive frames of a drive."
    whole = replace(blocks, block_frames=20).split(FRAMES)
    assert "this is a split by drive" in whole.note
    gaps = replace(blocks, block_gap=1).split(FRAMES)
    n_left_out = len(FRAMES) - sum(map(len, gaps.frames.values()))
    assert n_left_out > 0
    assert f" {n_left_out} frame(s) between blocks" in gaps.note


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"test": "both"}, r"split\.test='both': expected own or unseen"),
        ({"unseen_rigs": 0.0}, r"split\.test=unseen .*unseen_rigs=0 .*say 0\.2.*split\.test=own"),
        ({"unseen_rigs": 25}, r"unseen_rigs=25: expected a number of at least 0 and below 1"),
        ({"unseen_rigs": 0.98}, r"holds out 20 of 20 rig\(s\)"),
        ({"unseen_rigs": 0.9}, r"at least 4 rigs.* there are 2 .*had held out 18 rig\(s\) before"),
        ({"by": "official", "official": OFFICIAL}, r"unseen_rigs=0\.2, but split\.by=official"),
        ({"by": "block", "block_frames": None}, r"split\.block_frames=None"),
        ({"by": "sequence"}, r"split\.by='sequence': expected frame or block or drive or rig"),
        ({"train_frames": 1000}, r"split\.train_frames=1000, but this split has 2\d\d training"),
    ],
)
def test_errors_name_the_key_the_value_and_the_remedy(
    changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(UNSEEN, **changes).split(FRAMES)  # type: ignore[arg-type]


def test_official_splits_are_capped_and_otherwise_as_they_were() -> None:
    settings = SplitSettings("official", PAPER, 0, OFFICIAL)
    whole, capped = settings.split(SEQUENCES), replace(settings, train_frames=20).split(SEQUENCES)
    assert [len(whole.frames[name]) for name in SPLITS] == [28, 6, 6, 40]
    assert [len(capped.frames[name]) for name in SPLITS] == [20, 6, 6, 40]
    assert "official test sequence(s)" in capped.note
    assert "20 of 28 frames" in capped.note


def test_a_recipe_of_an_earlier_checkpoint_still_splits() -> None:
    earlier = {
        "_target_": "uncal.data.datamodule.SplitSettings",
        "by": "rig",
        "fractions": list(PAPER),
        "official": None,
        "seed": 3,
    }
    split = instantiate(earlier).split(FRAMES)
    assert split.frames == split_frames(FRAMES, "rig", PAPER, 3)


def test_named_drives_test_and_the_others_share_the_rest() -> None:
    settings = SplitSettings("frame", (0.5, 0.0, 0.5, 0.0), 0, test_drives=["*1"])
    split = settings.split(FRAMES)
    assert {frame.drive for frame in split.frames["test"]} == {"drive1"}
    assert len(split.frames["test"]) == len(FRAMES) // 2
    assert {frame.drive for name in SPLITS[:3] for frame in split.frames[name]} == {"drive0"}
    assert [len(split.frames[name]) for name in SPLITS[:3]] == [120, 0, 120]
    assert "20 drive(s) test because split.test_drives names them" in split.note
    # The test's share does not count.
    assert replace(settings, fractions=(0.3, 0.0, 0.3, 0.4)).split(FRAMES) == split


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"test_drives": ["*_2"]},
            r"split\.test_drives names '\*_2', which .*; there are drive0, drive1",
        ),
        ({"test_drives": []}, "split.test_drives is an empty list"),
        ({"test_drives": ["drive*"]}, "names 2 of 2"),
        ({"test_drives": ["*1"], "fractions": (0.0, 0.0, 0.0, 1.0)}, "above 0"),
        ({"test_drives": ["*1"], "unseen_rigs": 0.2}, "choose one of them"),
    ],
)
def test_test_drives_that_cannot_be(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(SplitSettings("frame", PAPER, 0), **wrong).split(FRAMES)  # type: ignore[arg-type]


def test_the_configuration_splits_as_the_paper_and_offers_every_setting() -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", ["dataset=kitti"])
        block = compose("train", ["dataset=kitti", "split.by=block", "split.unseen_rigs=0.2"])
    plain = instantiate(config.split)
    assert plain.split(FRAMES) == FrameSplit(split_frames(FRAMES, "frame", PAPER, 0), "")
    settings = instantiate(block.split)
    assert (settings.by, settings.block_frames, settings.block_gap) == ("block", 20, 0)
    assert (settings.unseen_rigs, settings.test, settings.train_frames) == (0.2, "own", None)
