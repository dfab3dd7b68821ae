"""The paper's split of DSEC: whole sequences test, the frames of the others are shared out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from uncal.errors import ConfigurationError
from uncal.recordings.dsec_sequences import TRAIN, drive_of, paper_split
from uncal.recordings.frame import FrameId
from uncal.splits.splits import SPLITS, by_name, split_frames


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
    sequences = paper_split(drives, settings.held_out, seed)
    training = [frame_id for frame_id in frame_ids if frame_id.drive in sequences.training]
    test = [frame_id for frame_id in frame_ids if frame_id.drive in sequences.test]
    frames = split_frames(training, "frame", [*settings.fractions, 0.0], seed)
    return FrameSplit({**frames, "test": sorted(test, key=by_name)}, sequences.note)
