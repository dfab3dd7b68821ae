import pytest

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.splits.sequence_split import OfficialSettings, split_officially
from uncal.splits.split_settings import SplitSettings
from uncal.splits.splits import SPLITS

PAPER = OfficialSettings((0.70, 0.15, 0.15), held_out=0.15)


def frames(*sequences: str, each: int = 20) -> list[FrameId]:
    return [FrameId("rig", sequence, i) for sequence in sequences for i in range(each)]


def test_official_test_sequences_test_and_the_others_are_shared_out() -> None:
    ids = frames("zurich_city_04_a", "thun_01_a", "interlaken_00_a", "interlaken_00_c", "thun_00_a")
    split = split_officially(ids, PAPER, seed=0)
    assert {frame.drive for frame in split.frames["test"]} == {"thun_01_a", "interlaken_00_a"}
    assert [len(split.frames[name]) for name in SPLITS] == [42, 9, 9, 40]
    together = [frame for name in SPLITS for frame in split.frames[name]]
    assert len(together) == len(set(together)) == len(ids)
    assert "2 official test sequence(s)" in split.note
    assert "interlaken_00" in split.note


def test_without_an_official_test_sequence_whole_drives_are_held_out() -> None:
    ids = frames(*(f"sim_000{i}_{letter}" for i in range(5) for letter in "ab"))
    split = split_officially(ids, PAPER, seed=0)
    tested = {frame.drive for frame in split.frames["test"]}
    assert len(tested) == 2
    assert len({drive[:-2] for drive in tested}) == 1
    trained = {frame.drive for name in SPLITS[:3] for frame in split.frames[name]}
    assert not trained & tested
    assert "held out" in split.note


def test_settings_choose_it_and_others_stay_as_they_were() -> None:
    ids = frames("zurich_city_04_a", "thun_01_a")
    fractions = (0.25, 0.25, 0.25, 0.25)
    official = SplitSettings("official", fractions, 0, PAPER).split(ids)
    assert {frame.drive for frame in official.frames["test"]} == {"thun_01_a"}
    by_frame = SplitSettings("frame", fractions, 0, PAPER).split(ids)
    assert [len(by_frame.frames[name]) for name in SPLITS] == [10, 10, 10, 10]
    assert by_frame.note == ""


def test_other_recordings_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"2011_09_26_drive_0001_sync.*split\.by=frame"):
        split_officially(frames("2011_09_26_drive_0001_sync"), PAPER, seed=0)


def test_three_fractions_are_asked_for() -> None:
    with pytest.raises(ConfigurationError, match=r"fractions=\[0\.6, 0\.4\].*three"):
        split_officially(frames("thun_00_a"), OfficialSettings((0.6, 0.4), 0.15), seed=0)
