"""Where frames come from: a bag, or a recording in a known layout, perhaps still being written."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from omegaconf import OmegaConf

from uncal.errors import ConfigurationError, FrameError, RecordingError
from uncal.monitor.bag_source import BagSettings, bag_frames
from uncal.recordings.bag_stream import is_bag
from uncal.recordings.folder_listing import RIG_FILE
from uncal.recordings.frame import Frame, FrameId, Recording
from uncal.settings.configuration import CONFIG_DIR

POLL_S = 0.2
"""Seconds between looks at a folder that is being written to."""

SETTLED_S = 1.0
"""The newest frame is read once a later one is there, or after so long without news: before that
its files may be half written."""

_DATE = re.compile(r"\d{4}_\d{2}_\d{2}")
_NAME = re.compile(r"(.+)/(.+)/(\d+)")


@dataclass(frozen=True)
class SourceSettings:
    """Which frames of a folder, and whether to wait for more.

    Attributes:
        root: the folder.
        drives: names or patterns; None: all.
        camera: None: the layout's own; ``image_02``, ``image_2``, ``left`` and so on.
        stride: every n-th frame.
        follow: wait for frames that are still to be written.
        patience_s: of follow: seconds without a new frame after which it ends.
        bag: topics and nominal extrinsic where the source is a bag.
    """

    root: Path
    drives: Sequence[str] | None
    camera: str | None
    stride: int
    follow: bool
    patience_s: float
    bag: BagSettings = field(default_factory=BagSettings)


@dataclass(frozen=True)
class Unreadable:
    """A frame of the stream that cannot be read.

    Attributes:
        id: which.
        reason: for people.
    """

    id: FrameId
    reason: str


def open_recording(settings: SourceSettings) -> Recording:
    """Open a folder with the reader of its layout.

    Args:
        settings: which folder, and what of it.

    Raises:
        RecordingError: no folder, or none of the layouts.
    """
    root = settings.root.expanduser()
    if is_bag(root):
        raise RecordingError(
            f"{root} is a bag, which can be watched as source=, but not read twice; make a folder "
            f"of it: python -m uncal.convert source={root} root=FOLDER"
        )
    if not root.is_dir():
        raise RecordingError(f"source={root}: no such folder, .bag, .mcap or .db3 file")
    drives, stride = settings.drives, settings.stride
    names = [path.name for path in root.iterdir() if path.is_dir()]
    if any(_DATE.fullmatch(name) for name in names):
        from uncal.recordings.kitti import KittiRaw

        return KittiRaw(root, settings.camera or "image_02", stride, drives)
    if (root / RIG_FILE).is_file() or any((root / name / RIG_FILE).is_file() for name in names):
        from uncal.recordings.plain_folder import PlainFolder

        return PlainFolder(root, settings.camera, None, drives, stride)
    if "sequences" in names:
        from uncal.recordings.kitti_odometry import KittiOdometry

        return KittiOdometry(root, drives, settings.camera or "image_2", stride)
    if "data" in names or any((root / name / "events").is_dir() for name in names):
        from uncal.recordings.dsec import Dsec

        known = OmegaConf.load(Path(CONFIG_DIR) / "dataset" / "dsec.yaml")
        return Dsec(
            root,
            known.window_ms,
            known.min_events,
            drives,
            settings.camera or known.side,
            stride,
            known.scan_time,
        )
    raise RecordingError(
        f"source={root}: none of the known layouts: KITTI raw (date folders such as 2011_09_26), "
        f"KITTI odometry (sequences/), DSEC (sequences with events/, and data/) or a rig of one's "
        f"own ({RIG_FILE})"
    )


def stream(
    settings: SourceSettings, reported: dict[tuple[str, str], int], clock: Callable[[], float]
) -> Iterator[Frame | Unreadable]:
    """Frames in order of drive and number; those that cannot be read come as such.

    Args:
        settings: where from.
        reported: number of the last frame of each (rig, drive) that is not to come again; kept up
            to date here.
        clock: seconds, such as time.monotonic.

    Raises:
        RecordingError: the source cannot be used at all.
    """
    if is_bag(settings.root.expanduser()):
        yield from _of_bag(settings, reported)
        return
    last_news, newest = clock(), None
    while True:
        try:
            recording = open_recording(settings)
        except RecordingError:
            # A folder that is still empty.
            if not settings.follow or clock() - last_news > settings.patience_s:
                raise
            time.sleep(POLL_S)
            continue
        waiting = [
            (frame_id, reason)
            for frame_id, reason in _listed(recording)
            if frame_id.index > reported.get((frame_id.rig, frame_id.drive), -1)
        ]
        if waiting and waiting[-1] != newest:
            last_news, newest = clock(), waiting[-1]
        settled = not settings.follow or clock() - last_news > SETTLED_S
        for frame_id, reason in waiting if settled else waiting[:-1]:
            reported[frame_id.rig, frame_id.drive] = frame_id.index
            yield _load(recording, frame_id, reason)
        if not settings.follow or clock() - last_news > settings.patience_s:
            return
        time.sleep(POLL_S)


def check_source(settings: SourceSettings) -> None:
    """Refuse a source that cannot be watched, before the weights are loaded.

    Args:
        settings: where from.

    Raises:
        RecordingError: there are no frames.
        ConfigurationError: a bag that is to be followed, or a setting that concerns bags only, or
            folders only.
    """
    bag = is_bag(settings.root.expanduser())
    optional = [field.name for field in fields(settings.bag) if field.default is None]
    of_bags = {name: getattr(settings.bag, name) for name in optional}
    of_folders = {"drives": settings.drives, "camera": settings.camera}
    for name, value in (of_folders if bag else of_bags).items():
        if value is not None:
            raise ConfigurationError(
                f"{name}={value}: source={settings.root} is a {'bag' if bag else 'folder'}, of "
                f"which nothing reads {name}; leave it out"
            )
    if not bag:
        if not settings.follow:
            open_recording(settings)
    elif settings.follow:
        raise ConfigurationError(
            "follow=true: a bag has its index at its end and cannot be read while it is written; "
            "follow a folder, or use the library in a node (examples/ros2_node.py)"
        )


def _of_bag(
    settings: SourceSettings, reported: dict[tuple[str, str], int]
) -> Iterator[Frame | Unreadable]:
    for seen in bag_frames(settings.root.expanduser(), settings.bag):
        frame_id, reason = (seen.id, None) if isinstance(seen, Frame) else seen
        place = frame_id.rig, frame_id.drive
        if frame_id.index % settings.stride or frame_id.index <= reported.get(place, -1):
            continue
        reported[place] = frame_id.index
        yield seen if isinstance(seen, Frame) else Unreadable(frame_id, str(reason))


def last_reported(names: Sequence[str]) -> dict[tuple[str, str], int]:
    """Number of the last frame of each (rig, drive).

    Args:
        names: of frames, in order.

    Raises:
        ConfigurationError: a name is none.

    >>> last_reported(["a/b/0000000001", "a/b/0000000002"])
    {('a', 'b'): 2}
    """
    found: dict[tuple[str, str], int] = {}
    for name in names:
        frame_id = parse_frame_id(name)
        if frame_id is None:
            raise ConfigurationError(f"{name}: not the name of a frame (rig/drive/0000000007)")
        found[frame_id.rig, frame_id.drive] = frame_id.index
    return found


def parse_frame_id(name: str) -> FrameId | None:
    """The inverse of ``str(frame_id)``; None for names of sequences and files.

    Args:
        name: such as rig/drive/0000000007.
    """
    match = _NAME.fullmatch(name)
    return FrameId(match[1], match[2], int(match[3])) if match else None


def _listed(recording: Recording) -> list[tuple[FrameId, str | None]]:
    """All frames with what is already known to be wrong with them, in order."""
    found: list[tuple[FrameId, str | None]] = [(frame_id, None) for frame_id in recording.frame_ids]
    for name, reason in recording.skipped.items():
        frame_id = parse_frame_id(name)
        if frame_id is not None:
            found.append((frame_id, reason))
    return sorted(found, key=lambda item: (item[0].rig, item[0].drive, item[0].index))


def _load(recording: Recording, frame_id: FrameId, reason: str | None) -> Frame | Unreadable:
    if reason is not None:
        return Unreadable(frame_id, reason)
    try:
        return recording.load(frame_id)
    except FrameError as error:
        return Unreadable(frame_id, str(error))
