"""A bag gives the frames, and the numbers, of the folder that it came from."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]

from uncal.errors import ConfigurationError
from uncal.monitor.bag_source import BagSettings
from uncal.monitor.sources import SourceSettings, Unreadable, check_source, stream
from uncal.recordings.bag_conversion import write_folder
from uncal.recordings.bag_stream import BagStream
from uncal.recordings.frame import Frame
from uncal.recordings.kitti import KittiRaw
from uncal.simulation.formats.bag import drive_as_bag, write_bag

Run = Callable[..., "subprocess.CompletedProcess[str]"]

DRIVE = "2041_01_02_drive_0001_sync"


def source(root: Path, follow: bool = False, stride: int = 1, **bag: object) -> SourceSettings:
    return SourceSettings(root, None, None, stride, follow, 1.0, BagSettings(**bag))  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_frames_of_a_bag_are_those_of_its_folder(recorded: Path, tmp_path: Path, kind: str) -> None:
    recording = KittiRaw(recorded, drives=[DRIVE], untwist=False)
    frames = [recording.load(frame_id) for frame_id in recording.frame_ids]
    path = tmp_path / ("drive.bag" if kind == "ros1" else "drive")
    times = [100.0 + 0.1 * number for number in range(len(frames))]
    images = [(t, f.image) for t, f in zip(times, frames, strict=True) if f.image is not None]
    # The third image is late, and the sweep left without one.
    images[2] = (images[2][0] + 0.06, images[2][1])
    scans = [(t, frame.points) for t, frame in zip(times, frames, strict=True)]
    T = frames[0].T_cam_lidar
    write_bag(path, images, scans, frames[0].K, None if kind == "ros1" else T, kind=kind)
    extrinsic = None
    if kind == "ros1":
        extrinsic = tmp_path / "nominal.yaml"
        extrinsic.write_text(yaml.safe_dump({"T_cam_lidar": T.tolist()}))
        with pytest.raises(ConfigurationError, match="extrinsic=FILE"):
            list(stream(source(path, tolerance_s=0.04), {}, lambda: 0.0))
    reported: dict[tuple[str, str], int] = {}
    settings = source(path, tolerance_s=0.04, extrinsic=extrinsic)
    seen = list(stream(settings, reported, lambda: 0.0))
    assert reported == {("drive", "drive"): 3}
    missed = seen.pop(2)
    assert isinstance(missed, Unreadable)
    assert "no image within 0.04 s" in missed.reason
    for item, frame in zip(seen, [*frames[:2], frames[3]], strict=True):
        assert isinstance(item, Frame)
        assert item.image is not None
        np.testing.assert_array_equal(item.image, frame.image)
        np.testing.assert_allclose(item.points, frame.points, atol=1e-6)
        np.testing.assert_allclose(item.K, frame.K)
        np.testing.assert_allclose(item.T_cam_lidar, T, atol=1e-9)
    # Gone on with after the second frame, every second one.
    late = list(stream(source(path, stride=2, tolerance_s=0.07, extrinsic=extrinsic),
                       {("drive", "drive"): 1}, lambda: 0.0))  # fmt: skip
    assert [item.id.index for item in late] == [2]


def test_numbers_of_a_bag_are_those_of_its_folder(
    recorded: Path, references: Path, settings: tuple[str, ...], tmp_path: Path, start: Run
) -> None:
    bag = drive_as_bag(recorded, DRIVE, tmp_path / "rig")
    with BagStream(bag) as opened:
        write_folder(opened, tmp_path / "as_folder" / "rig", "rig", "camera", "lidar",
                     opened.T_cam_lidar, progress=False)  # fmt: skip
    said = []
    for name, root in {"bag": bag, "folder": tmp_path / "as_folder" / "rig"}.items():
        run = tmp_path / name
        done = start(
            "uncal.monitor.__main__",
            *(f"source={root}", f"references={references}", f"hydra.run.dir={run}"),
            *settings,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        said.append([json.loads(line) for line in (run / "monitor.jsonl").open()])
    assert len(said[0]) == 4
    for ours, theirs in zip(*said, strict=True):
        assert (ours["frame"], ours["verdict"]) == (theirs["frame"], theirs["verdict"])
        for key in ("correction", "lower", "upper", "joint_lower", "sigma"):
            np.testing.assert_allclose(ours[key], theirs[key], rtol=1e-3, atol=1e-7)


def test_a_sensor_that_falls_silent_is_said(tmp_path: Path) -> None:
    images = [(0.1 * number, np.zeros((4, 4, 3), np.uint8)) for number in range(40)]
    scans = [(0.0, np.ones((3, 4), np.float32))]
    path = write_bag(tmp_path / "drive", images, scans, np.eye(3), np.eye(4))
    first, *rest = stream(source(path), {}, lambda: 0.0)
    assert isinstance(first, Frame)
    assert rest
    for item in rest:
        assert isinstance(item, Unreadable)
        assert "no LiDAR sweep" in item.reason


def test_a_bag_is_not_followed(recorded: Path, tmp_path: Path) -> None:
    bag = drive_as_bag(recorded, DRIVE, tmp_path / "rig")
    with pytest.raises(ConfigurationError, match="follow=true: a bag"):
        check_source(source(bag, follow=True))
    check_source(source(bag))


def test_a_bag_is_of_one_drive(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"drive=\*: matches .*; give one of them"):
        drive_as_bag(recorded, "*", tmp_path / "all")
    assert not (tmp_path / "all").exists()
