from __future__ import annotations

import logging
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.errors import FrameError, RecordingError
from uncal.recordings.dsec import Dsec
from uncal.recordings.frame import FrameId

MakeScan = Callable[..., NDArray[np.void]]
Write = Callable[..., None]
AddSequence = Callable[..., None]

START_US = 50_000_000_000  # time of day at which the drive begins
DRIVE_START_NS = 18_500 * 86_400_000_000_000 + 1000 * START_US


def read(
    root: Path,
    sequences: list[str] | None = None,
    window_ms: float = 40,
    min_events: int = 10,
) -> Dsec:
    return Dsec(root, window_ms, min_events, sequences)


def indices(recording: Dsec, drive: str) -> list[int]:
    return [frame_id.index for frame_id in recording.frame_ids if frame_id.drive == drive]


def test_windows_with_too_few_events_are_skipped(dsec_root: Path, write_events: Write) -> None:
    t = np.arange(0, 300_000, 100)
    quiet = t[(t < 150_000) | (t >= 199_000)]
    write_events(dsec_root / "sim_00_a" / "events" / "left", quiet, START_US)
    recording = read(dsec_root, ["sim_00_a"])
    assert indices(recording, "sim_00_a") == [0, 1, 2, 4, 5]
    reason = recording.skipped["sim_00/sim_00_a/0000000003"]
    assert reason.startswith("too few events: at most 0 in the 40 ms before the scan")


def test_exact_number_of_events_is_checked_on_loading(dsec_root: Path) -> None:
    # The window [104.75, 145) ms touches the events from 104 ms on, 410, and holds 402.
    recording = read(dsec_root, ["sim_00_a"], window_ms=40.25, min_events=405)
    assert FrameId("sim_00", "sim_00_a", 2) in recording.frame_ids
    with pytest.raises(FrameError, match=r"events: 402 in the 40\.25 ms .* min_events is 405"):
        recording.load(FrameId("sim_00", "sim_00_a", 2))


def test_gaps_are_counted_and_do_not_shift_the_scans(
    dsec_root: Path, add_bag: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    add_bag("sim_00", numbers=[0, 1, 3, 4, 5, 6, 7, 10, 11])
    recording = read(dsec_root, ["sim_00*"])
    assert recording.scan_gaps == {"sim_00": 2}
    assert recording.scan_rates["sim_00"] == pytest.approx(20)
    assert "scans are missing in 2 gaps" in caplog.text
    numbers = [int(recording.load(i).points[0, 0]) for i in recording.frame_ids]
    assert numbers == [0, 1, 3, 4, 5, 6, 7, 10, 11]
    assert indices(recording, "sim_00_b") == [0, 1, 2, 3]


def test_unusable_sequences_are_skipped_with_the_reason(
    dsec_root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = dsec_root / "data" / "sim_01" / "lidar_imu.bag"
    bag.write_bytes(bag.read_bytes()[:2000])
    events = dsec_root / "sim_00_a" / "events" / "left" / "events.h5"
    events.write_bytes(events.read_bytes()[:3000])
    with caplog.at_level(logging.WARNING):
        recording = read(dsec_root)
    assert {frame_id.drive for frame_id in recording.frame_ids} == {"sim_00_b"}
    assert re.search(r"events\.h5 cannot be read", recording.skipped["sim_00_a"])
    assert re.search(r"no complete ROS 1 bag", recording.skipped["sim_01_a"])
    assert "left out sequence sim_01_a" in caplog.text


def test_sequences_without_lidar_are_skipped(dsec_root: Path, add_sequence: AddSequence) -> None:
    add_sequence("sim_02_a", lidar_x=0.7)
    recording = read(dsec_root)
    expected = f"no LiDAR recording at {dsec_root / 'data' / 'sim_02' / 'lidar_imu.bag'}"
    assert recording.skipped == {"sim_02_a": expected}
    (dsec_root / "sim_00_b" / "calibration" / "cam_to_cam.yaml").unlink()
    recording = read(dsec_root, ["sim_00*"])
    assert list(recording.skipped) == ["sim_00_b"]


def test_damaged_scans_are_counted(dsec_root: Path, make_scan: MakeScan, write_bag: Write) -> None:
    empty = 2
    scans = [
        (DRIVE_START_NS + 50_000_000 * i, make_scan(i)[: 0 if i == empty else 5]) for i in range(6)
    ]
    write_bag(dsec_root / "data" / "sim_00" / "lidar_imu.bag", scans)
    recording = read(dsec_root, ["sim_00_a"])
    assert indices(recording, "sim_00_a") == [0, 1, 2, 3, 4]
    assert recording.skipped == {
        "sim_00/lidar_imu.bag": "1 scans cannot be read, the last one: the point cloud is empty"
    }


def test_scans_of_another_time_are_told_apart(
    dsec_root: Path, add_bag: Callable[..., Path]
) -> None:
    add_bag("sim_00", start_ns=DRIVE_START_NS + 3_600_000_000_000)
    with pytest.raises(
        RecordingError, match=r"events, 13:53:20 to 13:53:20 UTC; the scans are from 14:53:20 to"
    ):
        read(dsec_root, ["sim_00*"])


def test_nothing_usable_lists_the_reasons(dsec_root: Path) -> None:
    for drive in ("sim_00", "sim_01"):
        (dsec_root / "data" / drive / "lidar_imu.bag").unlink()
    with pytest.raises(RecordingError) as caught:
        read(dsec_root)
    message = str(caught.value)
    assert "No usable frame in 3 sequence(s)" in message
    assert "sim_00_b: no LiDAR recording at" in message
    assert "dsec-datasets/download" in message


@pytest.mark.parametrize("make", [False, True])
def test_missing_or_empty_root_says_how_to_get_one(tmp_path: Path, make: bool) -> None:
    nowhere = tmp_path / "dsec"
    if make:
        nowhere.mkdir()
    with pytest.raises(RecordingError) as caught:
        read(nowhere)
    message = str(caught.value)
    assert f"{nowhere}/zurich_city_04_a/events/left/events.h5" in message
    assert f"{nowhere}/data/zurich_city_04/lidar_imu.bag" in message
    assert "https://dsec.ifi.uzh.ch/dsec-datasets/download/" in message
    assert "uncal.simulate simulation=event_street root=data/dsec_standin" in message
    assert "dataset=dsec dataset.root=data/dsec_standin" in message


def test_sequence_given_as_root(dsec_root: Path) -> None:
    with pytest.raises(RecordingError, match=f"is itself a sequence: give its parent, {dsec_root}"):
        read(dsec_root / "sim_00_a")
