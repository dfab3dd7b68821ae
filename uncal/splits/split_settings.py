"""What ``conf/split`` says, and the split that follows from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from uncal.errors import ConfigurationError
from uncal.recordings.folder_listing import choose
from uncal.recordings.frame import FrameId
from uncal.settings.rules import either, number, require, words
from uncal.splits.sequence_split import FrameSplit, OfficialSettings, split_officially
from uncal.splits.splits import blocks, by_name, leave_gaps, seeded_hash, split_frames

TESTERS: tuple[str, ...] = ("own", "unseen")
"""Who may test: the split's own test part, or the rigs held out before the split."""


def hold_out_drives(
    frame_ids: Sequence[FrameId], patterns: Sequence[str]
) -> tuple[list[FrameId], list[FrameId]]:
    """Frames of the drives chosen by names or shell patterns, sorted; and the others.

    Raises:
        ConfigurationError: a pattern matches no drive, or no other drive remains.

    >>> frames = [FrameId("rig", f"drive_{i}", 0) for i in range(3)]
    >>> [len(part) for part in hold_out_drives(frames, ["*_2"])]
    [1, 2]
    """
    drives = sorted({frame_id.drive for frame_id in frame_ids})
    chosen = set(choose({name: [name] for name in drives}, patterns, "split.test_drives"))
    others = [frame_id for frame_id in frame_ids if frame_id.drive not in chosen]
    if not others:
        raise ConfigurationError(
            f"split.test_drives={list(patterns)} names {len(chosen)} of {len(drives)} drive(s): "
            "expected at least one, and others to calibrate on"
        )
    return sorted((f for f in frame_ids if f.drive in chosen), key=by_name), others


def hold_out_rigs(
    frame_ids: Sequence[FrameId], share: float, seed: int
) -> tuple[list[FrameId], list[FrameId]]:
    """The frames that remain, and those of a share of the rigs: the same whatever the split is by.

    Raises:
        ConfigurationError: ``share`` is out of range, or no rig would remain.

    >>> frames = [FrameId(f"rig{i}", "drive", 0) for i in range(10)]
    >>> kept, held_out = hold_out_rigs(frames, 0.2, seed=0)
    >>> len(kept), len(held_out)
    (8, 2)
    """
    rigs = sorted(
        {frame_id.rig for frame_id in frame_ids},
        key=lambda rig: seeded_hash(seed, f"unseen:{rig}"),
    )
    require("split.unseen_rigs", share, number(0, 1, below=True))
    n_out = max(1, math.floor(share * len(rigs) + 0.5)) if share > 0 else 0
    if 0 < n_out >= len(rigs):
        raise ConfigurationError(
            f"split.unseen_rigs={share} holds out {n_out} of {len(rigs)} rig(s), so that none "
            "remains to train on: use a smaller share, add recordings of other rigs, or set "
            "split.unseen_rigs=0"
        )
    out = set(rigs[:n_out])
    kept = [frame_id for frame_id in frame_ids if frame_id.rig not in out]
    held_out = [frame_id for frame_id in frame_ids if frame_id.rig in out]
    return kept, sorted(held_out, key=by_name)


def cap_training(training: Sequence[FrameId], n: int, seed: int) -> list[FrameId]:
    """Choose exactly ``n`` training frames, pseudo-randomly, so that all drives stay represented.

    The choice depends neither on the order of the frames nor on a random generator's version, and a
    smaller one is part of every larger one.

    Raises:
        ConfigurationError: ``n`` is not positive, or there are fewer frames.

    >>> training = [FrameId("rig", "drive", index) for index in range(100)]
    >>> len(cap_training(training, 30, seed=0))
    30
    """
    require("split.train_frames", n, either(number(1, 1e9, whole=True), None))
    if n > len(training):
        raise ConfigurationError(
            f"split.train_frames={n}, but this split has {len(training)} training frames: set "
            f"split.train_frames={len(training)} or less (null: all), raise the training share of "
            "the split's fractions, or add recordings"
        )
    order = sorted(training, key=lambda frame_id: seeded_hash(seed, f"training:{frame_id}"))
    return sorted(order[:n], key=by_name)


@dataclass(frozen=True)
class SplitSettings:
    """How frames are shared out.

    What trains, validates and calibrates does not depend on ``test``: one training serves both.
    The later settings do nothing by default, as in checkpoints that were made before them.

    Attributes:
        by: ``frame``, ``block``, ``drive`` or ``rig``: what is never torn apart; or ``official``.
        fractions: of the frames, in the order of :data:`uncal.splits.splits.SPLITS`.
        seed: of the shuffle.
        official: how ``official`` shares frames out.
        block_frames: of ``by=block``, consecutive frames of a drive.
        block_gap: of ``by=block``, frames in no split where blocks of different splits meet.
        unseen_rigs: share of the rigs that is held out before anything is split.
        test: ``own``, the split's own test part, or ``unseen``, all frames of the held-out rigs.
        train_frames: exactly so many of the training frames; None: all.
        test_drives: names or shell patterns of the drives that test; the others are split by
            ``fractions``, of which that of the test does not count. None: none.
    """

    by: str
    fractions: tuple[float, float, float, float]
    seed: int
    official: OfficialSettings | None = None
    block_frames: int | None = None
    block_gap: int = 0
    unseen_rigs: float = 0.0
    test: str = "own"
    train_frames: int | None = None
    test_drives: Sequence[str] | None = None

    def split(self, frame_ids: Sequence[FrameId], window: int = 1) -> FrameSplit:
        """Share all frames out; those that a setting leaves out are in no split.

        One estimate is made of a ``window`` of consecutive frames; ``frame`` and ``block`` keep
        whole windows together, so that those of one split never reach into another.

        Raises:
            ConfigurationError: a setting is out of range or does not fit these frames.
        """
        self._check()
        if self.test_drives is not None:
            return self._with_test_drives(frame_ids, self.test_drives, window)
        kept, held_out = hold_out_rigs(frame_ids, self.unseen_rigs, self.seed)
        try:
            shared = self._share_out(kept, window)
        except ConfigurationError as error:
            if not held_out:
                raise
            raise ConfigurationError(
                f"{error} (split.unseen_rigs={self.unseen_rigs} had held out {_n_rigs(held_out)} "
                "rig(s) before)"
            ) from error
        frames, notes = dict(shared.frames), [shared.note] if shared.note else []
        if self.train_frames is not None:
            available = len(frames["train"])
            frames["train"] = cap_training(frames["train"], self.train_frames, self.seed)
            if available > self.train_frames:
                notes.append(
                    f"Training uses {self.train_frames} of {available} frames (split.train_frames)."
                )
        if self.test == "unseen":
            frames["test"] = held_out
        if held_out:
            notes.append(self._unseen_note(frames, held_out))
        return FrameSplit(frames, " ".join(notes))

    def _with_test_drives(
        self, frame_ids: Sequence[FrameId], patterns: Sequence[str], window: int
    ) -> FrameSplit:
        tested, others = hold_out_drives(frame_ids, patterns)
        *shares, _ = self.fractions
        if not sum(shares) > 0:
            raise ConfigurationError(
                f"split.fractions={list(self.fractions)}: with split.test_drives the first three "
                "share out the other drives; at least one must be above 0"
            )
        train, validation, calibration = (share / sum(shares) for share in shares)
        rest = replace(
            self, test_drives=None, fractions=(train, validation, calibration, 0.0)
        ).split(others, window)
        drives = len({(frame_id.rig, frame_id.drive) for frame_id in tested})
        note = f"{drives} drive(s) test because split.test_drives names them. {rest.note}"
        return FrameSplit({**rest.frames, "test": tested}, note.strip())

    def _check(self) -> None:
        if self.test_drives is not None and (self.by == "official" or self.unseen_rigs != 0):
            raise ConfigurationError(
                "split.test_drives says which drives test; so do split.by=official and "
                "split.unseen_rigs: choose one of them"
            )
        require("split.test", self.test, words(*TESTERS))
        if self.test == "unseen" and self.unseen_rigs == 0:
            raise ConfigurationError(
                "split.test=unseen tests on the rigs held out before the split, but "
                "split.unseen_rigs=0 holds out none: set split.unseen_rigs to a share of the "
                "rigs, say 0.2, or use split.test=own"
            )
        if self.by == "official" and self.unseen_rigs != 0:
            raise ConfigurationError(
                f"split.unseen_rigs={self.unseen_rigs}, but split.by=official tests on sequences "
                "that DSEC names: set split.unseen_rigs=0, or use split.by=frame, block, drive or "
                "rig"
            )

    def _share_out(self, frame_ids: Sequence[FrameId], window: int) -> FrameSplit:
        if self.by == "official" and self.official is not None:
            return split_officially(frame_ids, self.official, self.seed)
        if self.by == "frame" and window > 1:
            return FrameSplit(
                split_frames(frame_ids, "block", self.fractions, self.seed, window),
                f"Windows of {window} consecutive frames are kept whole.",
            )
        if self.by == "block" and (self.block_frames or 0) % window:
            raise ConfigurationError(
                f"split.block_frames={self.block_frames}: expected a multiple of "
                f"window.frames={window}, so that no window reaches into another split"
            )
        whole = split_frames(frame_ids, self.by, self.fractions, self.seed, self.block_frames)
        if self.by != "block":
            return FrameSplit(whole, "")
        frames = leave_gaps(whole, self.block_frames, self.block_gap)
        note = f"A block is {self.block_frames} consecutive frames of a drive."
        drives = {(frame_id.rig, frame_id.drive) for frame_id in frame_ids}
        if len(blocks(frame_ids, self.block_frames)) == len(drives):
            note += " No drive makes two of them, so that this is a split by drive."
        if left_out := sum(len(whole[name]) - len(frames[name]) for name in whole):
            note += (
                f" {left_out} frame(s) between blocks of different splits are in none "
                f"(split.block_gap={self.block_gap})."
            )
        return FrameSplit(frames, note)

    def _unseen_note(self, frames: dict[str, list[FrameId]], held_out: Sequence[FrameId]) -> str:
        if self.test == "own":
            return (
                f"{_n_rigs(held_out)} rig(s) ({len(held_out)} frames) were held out before the "
                "split and are not used; split.test=unseen would test on them."
            )
        note = (
            f"The test frames are those of {_n_rigs(held_out)} rig(s) held out before the split "
            "(split.test=unseen)."
        )
        trained, calibrated = (
            {frame_id.rig for frame_id in frames[name]}
            for name in ("train", "uncertainty_calibration")
        )
        if trained & calibrated:
            note += (
                " The uncertainty was calibrated on rigs that training has seen, so that the "
                "coverage guarantee does not reach these frames."
            )
        return note


def _n_rigs(frame_ids: Sequence[FrameId]) -> int:
    return len({frame_id.rig for frame_id in frame_ids})
