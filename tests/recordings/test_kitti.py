from __future__ import annotations

import builtins
import io
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from uncal.errors import ConfigurationError, FrameError, RecordingError
from uncal.recordings.calibration_files import raw_calibration
from uncal.recordings.frame import FrameId, Recording
from uncal.recordings.kitti import KittiRaw

DRIVE = "2011_09_26_drive_0001_sync"
OTHER_DRIVE = "2011_09_26_drive_0002_sync"
OTHER_DATE_DRIVE = "2011_09_28_drive_0005_sync"


def drives_of(recording: KittiRaw) -> list[str]:
    return list(dict.fromkeys(frame_id.drive for frame_id in recording.frame_ids))


def test_lists_every_frame_in_order(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root)
    assert isinstance(recording, Recording)
    assert recording.frame_ids == [
        *(FrameId("2011_09_26", DRIVE, index) for index in range(4)),
        *(FrameId("2011_09_26", OTHER_DRIVE, index) for index in range(3)),
        *(FrameId("2011_09_28", OTHER_DATE_DRIVE, index) for index in range(2)),
    ]
    assert recording.skipped == {}


def test_loads_what_the_files_hold(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root)
    frame = recording.load(recording.frame_ids[1])
    folder = kitti_raw_root / "2011_09_26" / DRIVE
    scan = np.fromfile(folder / "velodyne_points/data/0000000001.bin", dtype=np.float32)
    image = cv2.imread(str(folder / "image_02/data/0000000001.png"))
    assert image is not None
    np.testing.assert_array_equal(frame.points, scan.reshape(-1, 4))
    np.testing.assert_array_equal(frame.image, image[..., ::-1])
    expected = raw_calibration(kitti_raw_root / "2011_09_26", 2)
    np.testing.assert_array_equal(frame.K, expected.K)
    np.testing.assert_array_equal(frame.T_cam_lidar, expected.T_cam_lidar)
    assert (frame.rig, frame.drive, frame.id.index) == ("2011_09_26", DRIVE, 1)
    assert frame.n_dropped == 0


def test_dates_are_rigs_with_their_own_extrinsic(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root)
    first, last = recording.load(recording.frame_ids[0]), recording.load(recording.frame_ids[-1])
    assert np.abs(first.T_cam_lidar - last.T_cam_lidar).max() > 0.01


def test_times_come_from_the_cameras_timestamps(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root, drives=["2011_09_26/0001"])
    times = [recording.load(frame_id).time for frame_id in recording.frame_ids]
    np.testing.assert_allclose(np.diff(times[:3]), 0.1, atol=1e-6)
    assert np.isnan(times[3])  # the file has three lines
    without = KittiRaw(kitti_raw_root, drives=["2011_09_26/0002"])
    assert np.isnan(without.load(without.frame_ids[0]).time)


@pytest.mark.parametrize(
    ("drives", "expected"),
    [
        (None, [DRIVE, OTHER_DRIVE, OTHER_DATE_DRIVE]),
        ([DRIVE], [DRIVE]),
        (["2011_09_26/0002"], [OTHER_DRIVE]),
        (["2011_09_26/*"], [DRIVE, OTHER_DRIVE]),
        (["*_0005_sync", DRIVE, DRIVE], [DRIVE, OTHER_DATE_DRIVE]),
        (["2011_09_28/000[0-9]"], [OTHER_DATE_DRIVE]),
    ],
)
def test_chooses_drives(
    kitti_raw_root: Path, drives: list[str] | None, expected: list[str]
) -> None:
    assert drives_of(KittiRaw(kitti_raw_root, drives=drives)) == expected


def test_drive_that_is_not_there_is_named_beside_those_that_are(kitti_raw_root: Path) -> None:
    with pytest.raises(
        ConfigurationError,
        match=r"'2011_09_26/0009'.* 2011_09_26/0001, 2011_09_26/0002, 2011_09_28/0005",
    ):
        KittiRaw(kitti_raw_root, drives=["2011_09_26/0001", "2011_09_26/0009"])
    with pytest.raises(ConfigurationError, match="empty list"):
        KittiRaw(kitti_raw_root, drives=[])


def test_incomplete_frames_are_skipped_either_way(kitti_raw_root: Path) -> None:
    folder = kitti_raw_root / "2011_09_26" / DRIVE
    (folder / "velodyne_points/data/0000000001.bin").unlink()
    (folder / "image_02/data/0000000002.png").unlink()
    recording = KittiRaw(kitti_raw_root, drives=[DRIVE])
    assert [frame_id.index for frame_id in recording.frame_ids] == [0, 3]
    assert set(recording.skipped) == {
        f"2011_09_26/{DRIVE}/0000000001",
        f"2011_09_26/{DRIVE}/0000000002",
    }
    assert "scan missing" in recording.skipped[f"2011_09_26/{DRIVE}/0000000001"]
    assert "image_02/data/0000000002.png" in recording.skipped[f"2011_09_26/{DRIVE}/0000000002"]


def test_stride_counts_the_incomplete_frames(kitti_raw_root: Path) -> None:
    folder = kitti_raw_root / "2011_09_26" / DRIVE
    (folder / "velodyne_points/data/0000000001.bin").unlink()
    recording = KittiRaw(kitti_raw_root, drives=[DRIVE], stride=2)
    assert [frame_id.index for frame_id in recording.frame_ids] == [0, 2]
    assert recording.skipped == {}
    with pytest.raises(ConfigurationError, match="stride is 0"):
        KittiRaw(kitti_raw_root, stride=0)


def test_truncated_scan_is_a_frame_error(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / DRIVE / "velodyne_points/data/0000000001.bin"
    path.write_bytes(path.read_bytes()[:-6])
    recording = KittiRaw(kitti_raw_root)
    with pytest.raises(FrameError, match=r"0000000001\.bin"):
        recording.load(recording.frame_ids[1])
    recording.load(recording.frame_ids[2])


def test_dropped_points_are_reported(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / DRIVE / "velodyne_points/data/0000000000.bin"
    points = np.fromfile(path, dtype=np.float32).reshape(-1, 4)
    points[7, 2] = np.nan
    points.tofile(path)
    recording = KittiRaw(kitti_raw_root)
    frame = recording.load(recording.frame_ids[0])
    assert (frame.n_dropped, len(frame.points)) == (1, 49)


def test_grey_camera(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root, camera="image_00", drives=[DRIVE])
    frame = recording.load(recording.frame_ids[0])
    expected = raw_calibration(kitti_raw_root / "2011_09_26", 0)
    np.testing.assert_array_equal(frame.T_cam_lidar, expected.T_cam_lidar)


def test_camera_that_was_not_recorded(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root, camera="image_00")
    assert drives_of(recording) == [DRIVE]
    assert len(recording.skipped) == 5
    with pytest.raises(RecordingError, match=r"No frame with an image and a scan(.|\n)*image_03"):
        KittiRaw(kitti_raw_root, camera="image_03")
    with pytest.raises(ConfigurationError, match="camera is 'image_2', expected one of image_00"):
        KittiRaw(kitti_raw_root, camera="image_2")


def test_missing_root_says_where_to_get_the_data(tmp_path: Path) -> None:
    root = tmp_path / "nowhere"
    with pytest.raises(RecordingError) as caught:
        KittiRaw(root)
    message = str(caught.value)
    assert f"{root} does not exist" in message
    assert "https://www.cvlibs.net/datasets/kitti/raw_data.php" in message
    assert f"{root}/2011_09_26/calib_cam_to_cam.txt" in message
    assert f"python -m uncal.simulate root={root}" in message


def test_wrong_root_says_what_is_there(tmp_path: Path, kitti_raw_root: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"no date folder .* found nothing"):
        KittiRaw(tmp_path / "empty")
    with pytest.raises(RecordingError, match=r"no date folder .* found empty, raw"):
        KittiRaw(tmp_path)
    with pytest.raises(RecordingError, match=f"date folder: give its parent, {kitti_raw_root}"):
        KittiRaw(kitti_raw_root / "2011_09_26")


def test_date_folder_without_drives_says_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "2011_09_26" / "2011_09_26_drive_0001_extract").mkdir(parents=True)
    with pytest.raises(RecordingError, match=r"no drive folder .* 2011_09_26_drive_0001_extract"):
        KittiRaw(tmp_path)


def test_missing_calibration_is_named(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_28" / "calib_cam_to_cam.txt"
    path.unlink()
    with pytest.raises(RecordingError, match=re.escape(str(path))):
        KittiRaw(kitti_raw_root)
    KittiRaw(kitti_raw_root, drives=["2011_09_26/*"])  # the other rig is none of its business


def test_frame_of_another_recording_is_refused(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root, drives=[DRIVE])
    with pytest.raises(RecordingError, match=f"its drives are 2011_09_26/{DRIVE}"):
        recording.load(FrameId("2011_09_28", OTHER_DATE_DRIVE, 0))


def test_a_changed_frame_does_not_change_the_next(kitti_raw_root: Path) -> None:
    recording = KittiRaw(kitti_raw_root)
    before = recording.load(recording.frame_ids[0])
    before.T_cam_lidar[:] = 0.0
    before.K[:] = 0.0
    after = recording.load(recording.frame_ids[0])
    assert after.T_cam_lidar[3, 3] == 1.0
    assert after.K[2, 2] == 1.0


def test_listing_opens_no_frame(kitti_raw_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = kitti_raw_root / "2011_09_26" / OTHER_DRIVE
    for index in range(2_000):
        (folder / "image_02/data" / f"{index:010d}.png").touch()
        (folder / "velodyne_points/data" / f"{index:010d}.bin").touch()
    opened: list[str] = []
    real = io.open

    def noted(file: object, *rest: object, **named: object) -> object:
        opened.append(str(file))
        return real(file, *rest, **named)  # type: ignore[call-overload]

    for module in (io, builtins):
        monkeypatch.setattr(module, "open", noted)
    recording = KittiRaw(kitti_raw_root, drives=[OTHER_DRIVE])
    assert len(recording.frame_ids) == 2_000
    assert any(name.endswith(".txt") for name in opened)
    assert sum(name.endswith((".png", ".bin")) for name in opened) < 20


@pytest.mark.kitti
def test_real_frames_load(kitti_root: Path) -> None:
    recording = KittiRaw(kitti_root)
    assert recording.skipped == {}
    frames = [recording.load(frame_id) for frame_id in recording.frame_ids[::4]]
    for frame in frames:
        assert frame.image is not None
        assert frame.image.shape[2] == 3
        assert abs(frame.image.shape[1] - 2 * frame.K[0, 2]) < 60  # the principal point is central
        assert len(frame.points) > 90_000
        assert 0 <= frame.points[:, 3].min() <= frame.points[:, 3].max() <= 1
