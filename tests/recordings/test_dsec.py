from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.dsec import Dsec
from uncal.recordings.frame import FrameId, Recording

Write = Callable[..., None]
AddSequence = Callable[..., None]

DAY_NS = 86_400_000_000_000
START_US = 50_000_000_000  # time of day at which the drive begins
DRIVE_START_NS = 18_500 * DAY_NS + 1000 * START_US


def read(
    root: Path,
    sequences: list[str] | None = None,
    window_ms: float = 40,
    min_events: int = 10,
    stride: int = 1,
    scan_time: str = "end",
    side: str = "left",
) -> Dsec:
    return Dsec(root, window_ms, min_events, sequences, side, stride, scan_time)


def indices(recording: Dsec, drive: str) -> list[int]:
    return [frame_id.index for frame_id in recording.frame_ids if frame_id.drive == drive]


def test_every_scan_with_a_whole_window_is_a_frame(dsec_root: Path) -> None:
    recording = read(dsec_root)
    assert isinstance(recording, Recording)
    # Scans end 45, 95, ... ms after the drive's beginning: six in each sequence.
    assert recording.frame_ids == [
        *(FrameId("sim_00", "sim_00_a", index) for index in range(6)),
        *(FrameId("sim_00", "sim_00_b", index) for index in range(6)),
        *(FrameId("sim_01", "sim_01_a", index) for index in range(6)),
    ]
    assert recording.skipped == {}
    assert recording.scan_rates == pytest.approx({"sim_00": 20, "sim_01": 20})
    assert recording.scan_gaps == {"sim_00": 0, "sim_01": 0}


def test_frame_holds_the_scan_and_the_events_before_its_end(dsec_root: Path) -> None:
    frame = read(dsec_root).load(FrameId("sim_00", "sim_00_b", 2))
    # The third scan of sim_00_b is number 8: 400 to 445 ms of the drive, 145 ms of the sequence.
    assert frame.image is None
    assert frame.time == pytest.approx(DRIVE_START_NS / 1e9 + 0.445, abs=1e-6)
    np.testing.assert_allclose(frame.points[:, 0], 8)
    np.testing.assert_allclose(frame.points[:, 3], [0, 0.2, 0.4, 0.6, 1])
    np.testing.assert_array_equal(frame.K, [[5, 0, 3.5], [0, 6, 2.5], [0, 0, 1]])
    np.testing.assert_allclose(frame.T_cam_lidar @ [1.4, 0, 0, 1], [0.05, 0, 1, 1], atol=1e-12)
    assert frame.events is not None
    begin = START_US + 300_000 + 105_000
    assert frame.events.window == (begin, begin + 40_000)
    np.testing.assert_array_equal(frame.events.t, begin + np.arange(0, 40_000, 100))
    numbers = np.arange(1050, 1450)
    x, y = numbers % 8, numbers // 8 % 6
    np.testing.assert_array_equal(frame.events.x, (x + 0.25 * y - 0.5).astype(np.float32))
    np.testing.assert_array_equal(frame.events.y, (1.5 * y - 0.125 * x).astype(np.float32))
    assert frame.events.size == (6, 8)


def test_scan_time_may_be_the_stamp(dsec_root: Path) -> None:
    recording = read(dsec_root, ["sim_00_a"], scan_time="stamp")
    # The scan stamped 0 ms is within the sequence, but has no events before it.
    assert indices(recording, "sim_00_a") == [1, 2, 3, 4, 5]
    frame = recording.load(recording.frame_ids[0])
    assert frame.points[0, 0] == 1
    assert frame.events is not None
    assert frame.events.window[1] == START_US + 50_000


@pytest.mark.parametrize(("window_ms", "expected"), [(45, 6), (45.001, 5), (200, 2), (290, 1)])
def test_no_window_begins_before_the_first_event(
    dsec_root: Path, window_ms: float, expected: int
) -> None:
    recording = read(dsec_root, ["sim_00_a"], window_ms=window_ms)
    assert indices(recording, "sim_00_a") == list(range(6))[6 - expected :]
    assert recording.skipped == {}
    for frame_id in recording.frame_ids:
        events = recording.load(frame_id).events
        assert events is not None
        assert len(events) == pytest.approx(10 * window_ms, abs=1)


def test_window_longer_than_the_sequence_is_refused(dsec_root: Path) -> None:
    with pytest.raises(RecordingError, match="use a shorter window_ms"):
        read(dsec_root, window_ms=300)


def test_stride_counts_the_scans(dsec_root: Path) -> None:
    assert indices(read(dsec_root, stride=4), "sim_00_b") == [0, 4]


def test_chooses_sequences_and_keeps_the_names_of_rigs(
    dsec_root: Path, add_sequence: AddSequence, add_bag: Callable[..., Path]
) -> None:
    add_sequence("sim_02_a", lidar_x=0.5)  # the rig of sim_01
    add_bag("sim_02")
    for chosen in (["sim_02_a"], ["sim_02*", "sim_01_a"], None):
        ids = read(dsec_root, chosen).frame_ids
        assert {i.rig for i in ids if i.drive in ("sim_01_a", "sim_02_a")} == {"sim_01"}
    with pytest.raises(ConfigurationError, match=r"'zurich\*', which matches nothing"):
        read(dsec_root, ["zurich*"])


def test_drive_with_two_calibrations_is_two_rigs(
    dsec_root: Path, add_sequence: AddSequence
) -> None:
    add_sequence("sim_00_b", start_ms=300, lidar_x=0.6)
    rigs = {frame_id.drive: frame_id.rig for frame_id in read(dsec_root).frame_ids}
    assert rigs == {"sim_00_a": "sim_00", "sim_00_b": "sim_00_b", "sim_01_a": "sim_01"}


def test_sequences_may_be_in_train_and_test(dsec_root: Path) -> None:
    expected = read(dsec_root).frame_ids
    (dsec_root / "train").mkdir()
    (dsec_root / "sim_00_a").rename(dsec_root / "train" / "sim_00_a")
    assert read(dsec_root).frame_ids == expected


def test_calibration_beside_the_bag_serves_too(dsec_root: Path) -> None:
    (dsec_root / "sim_00_a" / "calibration" / "cam_to_lidar.yaml").rename(
        dsec_root / "data" / "sim_00" / "cam_to_lidar.yaml"
    )
    recording = read(dsec_root, ["sim_00*"])
    assert {frame_id.rig for frame_id in recording.frame_ids} == {"sim_00"}


def test_right_event_camera(dsec_root: Path, add_sequence: AddSequence) -> None:
    add_sequence("sim_00_a", side="right")
    recording = read(dsec_root, ["sim_00_a"], side="right")
    frame = recording.load(recording.frame_ids[0])
    assert frame.K[0, 0] == 8
    np.testing.assert_allclose(frame.T_cam_lidar @ [1.4, 0, 0, 1], [-0.1, 0, 1, 1], atol=1e-12)
    with pytest.raises(RecordingError, match=r"events/right/rectify_map\.h5 is missing"):
        read(dsec_root, ["sim_00_b"], side="right")


@pytest.mark.parametrize("day", [0, 18_500])
def test_drive_across_midnight(
    tmp_path: Path,
    add_bag: Callable[..., Path],
    write_events: Write,
    write_calibration: Write,
    day: int,
) -> None:
    start_us = 86_400_000_000 - 150_000  # 150 ms before midnight
    write_events(tmp_path / "sim_00_a/events/left", np.arange(0, 300_000, 100), start_us)
    write_calibration(tmp_path / "sim_00_a/calibration")
    add_bag("sim_00", start_ns=day * DAY_NS + 1000 * start_us)
    recording = read(tmp_path)
    assert indices(recording, "sim_00_a") == list(range(6))
    frame = recording.load(recording.frame_ids[-1])
    assert frame.points[0, 0] == 5
    assert frame.events is not None
    assert frame.events.window == (start_us + 255_000, start_us + 295_000)
    assert frame.time == pytest.approx(((day + 1) * DAY_NS + 145_000_000) / 1e9, abs=1e-6)


def test_pickled_reader_loads_the_same_frame(dsec_root: Path) -> None:
    recording = read(dsec_root)
    frame_id = recording.frame_ids[7]
    frame = recording.load(frame_id)
    copy = pickle.loads(pickle.dumps(recording)).load(frame_id)
    np.testing.assert_array_equal(copy.points, frame.points)
    np.testing.assert_array_equal(copy.events.x, frame.events.x if frame.events else None)


def test_unknown_frame_is_refused(dsec_root: Path) -> None:
    recording = read(dsec_root, ["sim_00_a"])
    for unknown in (FrameId("sim_00", "sim_00_b", 0), FrameId("sim_00", "sim_00_a", 6)):
        with pytest.raises(RecordingError, match="is none of this recording"):
            recording.load(unknown)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"window_ms": 0}, "window_ms=0: expected"),
        ({"window_ms": float("nan")}, "window_ms=nan: expected"),
        ({"min_events": -1}, "min_events=-1: expected"),
        ({"stride": 0}, "stride is 0"),
        ({"side": "middle"}, "expected one of left, right"),
        ({"scan_time": "middle"}, "expected one of end, stamp"),
    ],
)
def test_settings_out_of_range(dsec_root: Path, setting: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read(dsec_root, **setting)  # type: ignore[arg-type]
