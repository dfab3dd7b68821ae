"""Frames kept out of the splits on purpose: held-out rigs, training frames beyond a number."""

from __future__ import annotations

import math
from collections.abc import Sequence

from uncal.errors import ConfigurationError
from uncal.recordings.folder_listing import choose
from uncal.recordings.frame import FrameId
from uncal.settings.rules import either, number, require
from uncal.splits.splits import by_name, seeded_hash


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
