"""Units of estimation: single frames, or windows of consecutive frames of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias

from uncal.recordings.frame import FrameId
from uncal.settings.group import SettingsGroup
from uncal.settings.rules import number
from uncal.splits.splits import blocks, by_name

Unit: TypeAlias = tuple[FrameId, ...]
"""Frames of one drive that share one decalibration; the first gives it its name."""


@dataclass(frozen=True)
class WindowSettings(SettingsGroup):
    """How many frames one estimate is made of.

    Attributes:
        frames: consecutive frames of a drive whose evidence is added up; 1: each frame alone.
    """

    key: ClassVar[str] = "window"
    frames: Annotated[int, number(1, 1000, whole=True)]


def units_of(
    frame_ids: Sequence[FrameId], frames: int, recorded: Sequence[FrameId] | None = None
) -> list[Unit]:
    """Cut the frames of a split into units, in order.

    Args:
        frame_ids: of the split, sorted by rig, drive and number.
        frames: of a unit. What remains at the end of a drive, or before frames that are not of
            this split, is a window of its own; shorter than half a window, it joins the one
            before.
        recorded: all frames of the recording, in any order; None: those of the split.

    >>> some = [FrameId("rig", "drive", index) for index in range(5)]
    >>> [len(unit) for unit in units_of(some, 2)], [len(unit) for unit in units_of(some, 1)]
    ([2, 2, 1], [1, 1, 1, 1, 1])
    """
    if frames == 1:
        return [(frame_id,) for frame_id in frame_ids]
    runs = _runs(frame_ids, frame_ids if recorded is None else recorded)
    return [tuple(members) for run in runs for members in blocks(run, frames).values()]


def _runs(frame_ids: Sequence[FrameId], recorded: Sequence[FrameId]) -> list[list[FrameId]]:
    """Frames of one drive that follow each other in the recording."""
    number = {frame_id: i for i, frame_id in enumerate(sorted(recorded, key=by_name))}
    runs: list[list[FrameId]] = []
    for frame_id in sorted(frame_ids, key=by_name):
        last = runs[-1][-1] if runs else None
        follows = last is not None and number[frame_id] == number[last] + 1
        same = last is not None and (last.rig, last.drive) == (frame_id.rig, frame_id.drive)
        if same and follows:
            runs[-1].append(frame_id)
        else:
            runs.append([frame_id])
    return runs
