"""A folder of recordings, looked at drive by drive."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from uncal.checking import clocks, files, geometry
from uncal.checking.evidence import View, view_of
from uncal.checking.finding import DriveReport, Finding
from uncal.checking.layouts import Drive, find_layout
from uncal.errors import FrameError, RecordingError
from uncal.events.stream import PixelMap
from uncal.geometry.projection import project
from uncal.recordings.frame import Frame, FrameId, Recording
from uncal.recordings.sensor_files import write_image
from uncal.reporting.overlay import draw_events, overlay_panel
from uncal.system.disk import check_writable
from uncal.system.progress import watched

log = logging.getLogger(__name__)

RUN = 4
"""Consecutive frames that are compared with each other's scans."""


class Checked(NamedTuple):
    """What is known of a folder."""

    layout: str
    reports: list[DriveReport]  # of its drives, in order

    @property
    def findings(self) -> list[Finding]:
        """Of all drives."""
        return [finding for report in self.reports for finding in report.findings]


def check(
    root: Path, camera: str | None, n_frames: int, overlays: Path | None, quiet: bool = False
) -> Checked:
    """Check every drive of a folder, by the edges of ``n_frames`` frames; one picture per drive.

    Raises:
        RecordingError: the folder has none of the layouts.
    """
    layout, drives = find_layout(root, camera)
    if overlays is not None:
        check_writable(overlays / "overlay.png")
    reports = [_check(d, n_frames, overlays) for d in watched(drives, "checking", quiet=quiet)]
    return Checked(layout, reports)


def _check(drive: Drive, n_frames: int, overlays: Path | None) -> DriveReport:
    try:
        recording = drive.open()
    except RecordingError as error:
        return DriveReport(drive.name, 0, float("nan"), (files.of_error(drive.name, error),))
    found = files.of_files(drive.name, recording) + files.of_stamps(
        drive.name, drive.stamps(), drive.by_number
    )
    runs = chosen_runs(recording.frame_ids, n_frames)
    frames, unreadable = _load(recording, runs)
    if unreadable and not any(f.kind in ("truncated", "resolution") for f in found):
        found.append(
            Finding(
                "resolution" if "pixels, but" in unreadable[0] else "truncated",
                drive.name,
                f"{len(unreadable)} frames cannot be read; {unreadable[0]}",
                "files that can be read",
                "copy them again",
            )
        )
    frames = [run for run in frames if run]
    if not frames:
        return DriveReport(drive.name, len(recording.frame_ids), float("nan"), tuple(found))
    units = geometry.of_units(drive.name, frames[0][0].points)
    if units is not None:
        found.append(units)
        frames = [[_in_metres(frame) for frame in run] for run in frames]
    if (brightness := geometry.of_reflectance(drive.name, frames[0][0].points)) is not None:
        found.append(brightness)
    link = None if drive.link is None else drive.link()
    views = [[view_of(frame, link) for frame in run] for run in frames]
    judgement = geometry.judge([view for run in views for view in run])
    found += geometry.finding(
        drive.name, judgement, any(_in_view(f) for run in frames for f in run)
    )
    if judgement.repair is None:
        shifted = clocks.of_pairs(drive.name, views)
        if shifted:
            found = [f for f in found if f.kind != "unconfirmed"] + shifted
    overlay = None
    if overlays is not None:
        overlay = str(_draw(overlays / f"{drive.name}.png", frames[0][0], views[0][0], judgement))
    n = len(recording.frame_ids)
    return DriveReport(drive.name, n, judgement.support, tuple(found), overlay)


def chosen_runs(ids: Sequence[FrameId], n_frames: int) -> list[list[FrameId]]:
    """Stretches of :data:`RUN` consecutive frames, ``n_frames`` at most in all, over a drive.

    >>> ids = [FrameId("rig", "drive", i) for i in range(20)]
    >>> [[frame.index for frame in run] for run in chosen_runs(ids, 8)]
    [[0, 1, 2, 3], [16, 17, 18, 19]]
    """
    if len(ids) <= n_frames:
        return [list(ids)]
    n_runs = max(1, n_frames // RUN)
    starts = np.linspace(0, len(ids) - RUN, n_runs).round().astype(int)
    return [list(ids[start : start + RUN]) for start in starts]


def _load(
    recording: Recording, runs: Sequence[Sequence[FrameId]]
) -> tuple[list[list[Frame]], list[str]]:
    frames: list[list[Frame]] = []
    unreadable = []
    for run in runs:
        frames.append([])
        for frame_id in run:
            try:
                frames[-1].append(recording.load(frame_id))
            except FrameError as error:
                unreadable.append(str(error))
    return frames, unreadable


def _in_view(frame: Frame) -> bool:
    """Whether any point of the sweep falls into the image."""
    if frame.image is not None:
        size = (frame.image.shape[0], frame.image.shape[1])
    else:
        assert frame.events is not None
        size = frame.events.size
    points, T, K = (
        torch.from_numpy(np.asarray(array, np.float32))[None]
        for array in (frame.points, frame.T_cam_lidar, frame.K)
    )
    return bool((project(points, T, K, size).inverse_depth > 0).any())


def _in_metres(frame: Frame) -> Frame:
    points = frame.points.copy()
    points[:, :3] /= 1000.0
    return replace(frame, points=points)


def _draw(path: Path, frame: Frame, view: View, judgement: geometry.Judgement) -> Path:
    image = frame.image
    if image is None:
        assert frame.events is not None
        image = draw_events(frame.events, frame.events.size, PixelMap.identity())
    path.parent.mkdir(parents=True, exist_ok=True)
    panel = overlay_panel(image, frame.points, frame.K, {"as declared": frame.T_cam_lidar}, 1)
    repair = judgement.repair
    if repair is not None:
        scale = frame.K[0, 0] / float(view.K[0, 0])
        K = frame.K if repair.K is None else repair.K.double().numpy() * [[scale], [scale], [1.0]]
        T = repair.T.double().numpy()
        panel = np.concatenate(
            [panel, overlay_panel(image, frame.points, K, {f"repaired: {repair.kind}": T}, 1)]
        )
    write_image(path, panel)
    return path
