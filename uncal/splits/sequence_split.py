"""The paper's split of DSEC: whole sequences test, the frames of the others are shared out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from uncal.errors import ConfigurationError
from uncal.recordings.dsec_layout import TEST, TRAIN, drive_of
from uncal.recordings.frame import FrameId
from uncal.settings.rules import number, require
from uncal.splits.splits import SPLITS, by_name, seeded_hash, split_frames


class FrameSplit(NamedTuple):
    """Which frames do what.

    Attributes:
        frames: split → its frames.
        note: a sentence for the report, or nothing.
    """

    frames: Mapping[str, list[FrameId]]
    note: str


@dataclass(frozen=True)
class OfficialSettings:
    """How ``split.by=official`` shares frames out.

    Attributes:
        fractions: of the training sequences' frames: training, validation, uncertainty calibration
            (the paper: 70/15/15).
        held_out: share of the sequences to test on where no official test sequence has LiDAR.
    """

    fractions: Sequence[float]
    held_out: float


def split_officially(
    frame_ids: Sequence[FrameId], settings: OfficialSettings, seed: int
) -> FrameSplit:
    """Test on DSEC's official test sequences; see :func:`paper_split`.

    Raises:
        ConfigurationError: the drives are not DSEC's, a fraction is out of range, or there is
            nothing to train or to test on.
    """
    drives = sorted({frame_id.drive for frame_id in frame_ids})
    if all(drive_of(drive) == drive for drive in drives):
        raise ConfigurationError(
            f"split.by=official is for the sequences of DSEC, named like {TRAIN[0]}; there are "
            f"{', '.join(drives[:3])}: use split.by=frame, block, drive or rig"
        )
    if len(settings.fractions) != len(SPLITS) - 1:
        raise ConfigurationError(
            f"split.official.fractions={list(settings.fractions)}: expected three numbers, for "
            "training, validation and uncertainty calibration"
        )
    test_drives, note = paper_split(drives, settings.held_out, seed)
    training = [frame_id for frame_id in frame_ids if frame_id.drive not in test_drives]
    test = [frame_id for frame_id in frame_ids if frame_id.drive in test_drives]
    frames = split_frames(training, "frame", [*settings.fractions, 0.0], seed)
    return FrameSplit({**frames, "test": sorted(test, key=by_name)}, note)


def paper_split(
    with_lidar: Iterable[str], held_out: float, seed: int
) -> tuple[tuple[str, ...], str]:
    """The paper's split of DSEC: the official test sequences test, the others train.

    Nothing can be tested on a sequence without LiDAR. Where that leaves no official test sequence,
    whole drives of the training sequences are held out instead: frames of one drive share the
    street, the light and the extrinsic.

    Args:
        with_lidar: names of the sequences that have frames. Names in neither official list (a
            simulated stand-in) count as training sequences.
        held_out: share to hold out, in (0, 1); rounded up to whole drives.
        seed: another seed, other drives held out.

    Returns:
        The sequences that test, sorted, and a sentence or two for the report.

    Raises:
        ConfigurationError: ``held_out`` is out of range, or there is nothing to train on or to
            hold out.

    >>> paper_split(["thun_00_a", "thun_01_a"], held_out=0.15, seed=0)[0]
    ('thun_01_a',)
    """
    require("split.official.held_out", held_out, number(0, 1, above=True, below=True))
    names = sorted(set(with_lidar))
    test = [name for name in names if name in TEST]
    training = [name for name in names if name not in TEST]
    if not training:
        raise ConfigurationError(
            f"No training sequence among {', '.join(names) or 'none'}; add one of the official "
            f"ones, such as {TRAIN[0]}, or use split.by=drive."
        )
    if test:
        note = (
            f"Test set: the {len(test)} official test sequence(s) with LiDAR ({', '.join(test)})."
        )
        if both := sorted(set(map(drive_of, training)) & set(map(drive_of, test))):
            note += f" Of the drive(s) {', '.join(both)}, other parts are in training."
        return tuple(test), note
    drives = sorted(set(map(drive_of, training)), key=lambda drive: seeded_hash(seed, drive))
    if len(drives) < 2:
        raise ConfigurationError(
            f"There is no official test sequence with LiDAR, and the training sequences "
            f"({', '.join(training)}) are all of the drive {drives[0]}, so that none can be held "
            "out: add another drive, or use split.by=frame."
        )
    for drive in drives[:-1]:
        if len(test) < held_out * len(training):
            test += [name for name in training if drive_of(name) == drive]
    held = sorted(set(map(drive_of, test)))
    return tuple(sorted(test)), (
        f"No official test sequence with LiDAR: the test set is {len(held)} whole drive(s) held "
        f"out of the training ones ({', '.join(held)})."
    )
