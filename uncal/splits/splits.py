"""Which frames train, validate, calibrate the uncertainty and test; no frame does two of these."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import cast

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.settings.rules import listed, number, require, words

SPLITS: tuple[str, ...] = ("train", "validation", "uncertainty_calibration", "test")
"""The four splits, in the order of their fractions."""

UNITS: tuple[str, ...] = ("frame", "block", "drive", "rig")
"""What may be kept whole: a frame (near-duplicates leak), a block, a drive, a rig."""

FRACTIONS = listed(number(0, 1), len(SPLITS), total=1)

BLOCK = number(1, 1_000_000, whole=True)
"""Frames of a block."""


def blocks(frame_ids: Iterable[FrameId], length: int | None) -> dict[str, list[FrameId]]:
    """Cut every drive into blocks of ``length`` frames.

    Frames count by their position among those of their drive, so that missing ones do not matter.
    What remains at the end of a drive is a block of its own; shorter than half a block it joins the
    one before, if there is one.

    Returns:
        Name of the block, ``rig/drive/block000``, → its frames by number.

    Raises:
        ConfigurationError: ``length`` is not a positive whole number.

    >>> cut = blocks([FrameId("rig", "drive", index) for index in range(9)], length=4)
    >>> {name: [frame.index for frame in frames] for name, frames in cut.items()}
    {'rig/drive/block000': [0, 1, 2, 3], 'rig/drive/block001': [4, 5, 6, 7, 8]}
    """
    return {
        f"{rig}/{drive}/block{number:03d}": frames
        for (rig, drive), members in _cut(frame_ids, length).items()
        for number, frames in enumerate(members)
    }


def leave_gaps(
    splits: Mapping[str, list[FrameId]], length: int | None, gap: int
) -> dict[str, list[FrameId]]:
    """Leave out the last ``gap`` frames of every block that the next one does not join.

    Raises:
        ConfigurationError: ``gap`` is negative, or so large that it could take a whole block.
    """
    require("split.block_frames", length, BLOCK)
    if not isinstance(gap, int) or gap < 0 or (gap > 0 and 2 * gap >= cast(int, length)):
        raise ConfigurationError(
            f"split.block_gap={gap}: expected 0 or more frames, and fewer than half a block "
            f"(split.block_frames={length}): lower it, or raise split.block_frames"
        )
    if gap == 0:
        return dict(splits)
    split_of = {frame: name for name, frames in splits.items() for frame in frames}
    out: set[FrameId] = set()
    for members in _cut(split_of, length).values():
        for block, following in itertools.pairwise(members):
            if split_of[block[-1]] != split_of[following[0]]:
                out.update(block[-gap:])
    return {
        name: [frame for frame in frames if frame not in out] for name, frames in splits.items()
    }


def _cut(
    frame_ids: Iterable[FrameId], length: int | None
) -> dict[tuple[str, str], list[list[FrameId]]]:
    """(Rig, drive) → its blocks in order."""
    require("split.block_frames", length, BLOCK)
    step = cast(int, length)
    drives: dict[tuple[str, str], list[FrameId]] = {}
    for frame_id in frame_ids:
        drives.setdefault((frame_id.rig, frame_id.drive), []).append(frame_id)
    cut = {}
    for drive, frames in drives.items():
        frames.sort(key=lambda frame_id: frame_id.index)
        starts = list(range(0, len(frames), step))
        if len(starts) > 1 and 2 * (len(frames) - starts[-1]) < step:
            starts.pop()
        ends = [*starts[1:], len(frames)]
        cut[drive] = [frames[start:end] for start, end in zip(starts, ends, strict=True)]
    return cut


def split_frames(
    frame_ids: Iterable[FrameId],
    by: str,
    fractions: Sequence[float],
    seed: int,
    block_frames: int | None = None,
) -> dict[str, list[FrameId]]:
    """Split frames into :data:`SPLITS`, keeping frames, blocks, drives or rigs whole.

    The units are put in a pseudo-random order and each goes to the split that lacks most frames.
    With frames as units this is rounding by largest remainder. Every split with a fraction above
    zero gets a unit. Units are not sorted by size first, although that would meet the fractions
    more closely: a split of the largest drives would not be exchangeable with the others.

    The order is that of a hash of (seed, name of the unit), so the result depends neither on the
    order of ``frame_ids`` nor on a random generator's version.

    Args:
        frame_ids: all frames to be split, each once.
        by: one of :data:`UNITS`.
        fractions: of all frames, one per split, summing to 1.
        seed: another seed, another split.
        block_frames: of ``by="block"``, how many consecutive frames of a drive are a block; see
            :func:`uncal.splits.splits.blocks`.

    Returns:
        Split → its frames, sorted by rig, drive and number; together exactly ``frame_ids``.

    Raises:
        ConfigurationError: ``by`` or ``fractions`` are out of range, or there are fewer units than
            splits to fill.
        ValueError: a frame comes twice.

    >>> frames = [FrameId("rig", "drive", index) for index in range(40)]
    >>> splits = split_frames(frames, "frame", (0.6, 0.15, 0.15, 0.1), seed=0)
    >>> [len(splits[name]) for name in SPLITS]
    [24, 6, 6, 4]
    """
    require("split.by", by, words(*UNITS))
    require("split.fractions", list(fractions), FRACTIONS)
    units = _units(frame_ids, by, block_frames)
    n_frames = sum(map(len, units.values()))
    used = [split for split, fraction in enumerate(fractions) if fraction > 0]
    if len(units) < len(used):
        raise ConfigurationError(_too_few(units, by, len(used)))

    lacking = [fraction * n_frames for fraction in fractions]
    members: list[list[FrameId]] = [[] for _ in SPLITS]
    order = sorted(units, key=lambda name: seeded_hash(seed, name))
    for position, name in enumerate(order):
        empty = [split for split in used if not members[split]]
        candidates = empty if len(order) - position == len(empty) else used
        split = max(candidates, key=lambda split: lacking[split])
        members[split] += units[name]
        lacking[split] -= len(units[name])
    return {
        split: sorted(frames, key=by_name) for split, frames in zip(SPLITS, members, strict=True)
    }


def seeded_hash(seed: int, name: str) -> bytes:
    """A number that orders names pseudo-randomly."""
    return hashlib.blake2b(f"{seed}:{name}".encode(), digest_size=16).digest()


def by_name(frame_id: FrameId) -> tuple[str, str, int]:
    """Sort key: rig, drive and number."""
    return frame_id.rig, frame_id.drive, frame_id.index


def _units(
    frame_ids: Iterable[FrameId], by: str, block_frames: int | None
) -> dict[str, list[FrameId]]:
    """Name of the unit → its frames."""
    members = list(frame_ids)
    twice = [frame_id for frame_id, n in Counter(members).items() if n > 1]
    if twice:
        raise ValueError(f"Frame {twice[0]} comes twice; the splits could then share it.")
    if by == "block":
        return blocks(members, block_frames)
    # Drives of different rigs may share a name.
    depth = {"rig": 1, "drive": 2, "frame": 3}[by]
    units: dict[str, list[FrameId]] = {}
    for frame_id in members:
        units.setdefault("/".join(str(frame_id).split("/")[:depth]), []).append(frame_id)
    return units


def _too_few(units: dict[str, list[FrameId]], by: str, n_splits: int) -> str:
    some = ", ".join(sorted(units)[:8]) or "none"
    remedy = {
        "frame": "add frames (a smaller stride, more drives)",
        "block": "lower split.block_frames, or add recordings",
    }.get(by, "use split.by=frame, or add recordings")
    return (
        f"split.by={by} needs at least {n_splits} {by}s, one per split, but there are "
        f"{len(units)} ({some}): {remedy}."
    )
