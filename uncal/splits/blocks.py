"""Blocks of consecutive frames: near-duplicates stay together, yet every drive may serve twice."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import cast

from uncal.errors import ConfigurationError
from uncal.recordings.frame import FrameId
from uncal.settings.rules import number, require

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
