from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uncal.errors import ConfigurationError, FrameError, RecordingError
from uncal.recordings.calibration_files import odometry_calibration
from uncal.recordings.frame import FrameId, Recording
from uncal.recordings.kitti_odometry import KittiOdometry


def test_lists_and_loads(kitti_odometry_root: Path) -> None:
    recording = KittiOdometry(kitti_odometry_root)
    assert isinstance(recording, Recording)
    assert [(frame_id.drive, frame_id.index) for frame_id in recording.frame_ids] == [
        (sequence, index) for sequence in ("00", "01", "03") for index in range(3)
    ]
    frame = recording.load(recording.frame_ids[-1])
    folder = kitti_odometry_root / "sequences" / "03"
    expected = odometry_calibration(folder / "calib.txt", 2)
    np.testing.assert_array_equal(frame.T_cam_lidar, expected.T_cam_lidar)
    np.testing.assert_array_equal(frame.K, expected.K)
    assert frame.time == pytest.approx(0.2072)
    scan = np.fromfile(folder / "velodyne/000002.bin", dtype=np.float32)
    np.testing.assert_array_equal(frame.points, scan.reshape(-1, 4))


def test_sequences_of_one_calibration_are_one_rig(kitti_odometry_root: Path) -> None:
    rigs = {f.drive: f.rig for f in KittiOdometry(kitti_odometry_root).frame_ids}
    assert rigs["00"] == rigs["01"] != rigs["03"]
    assert rigs["00"].startswith("calib-")
    path = kitti_odometry_root / "sequences" / "01" / "calib.txt"
    path.write_text(path.read_text().replace("\n", " \r\n"))
    again = {f.drive: f.rig for f in KittiOdometry(kitti_odometry_root).frame_ids}
    assert again == rigs


@pytest.mark.parametrize(
    ("sequences", "expected"),
    [(["01"], ["01"]), ([3, 0], ["00", "03"]), (["0[01]"], ["00", "01"]), ("03", ["03"])],
)
def test_chooses_sequences(
    kitti_odometry_root: Path, sequences: list[str | int], expected: list[str]
) -> None:
    recording = KittiOdometry(kitti_odometry_root, sequences=sequences, stride=3)
    assert [frame_id.drive for frame_id in recording.frame_ids] == expected


def test_sequence_that_is_not_there_is_named(kitti_odometry_root: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"sequences names '07'.* 00, 01, 03"):
        KittiOdometry(kitti_odometry_root, sequences=["07"])
    with pytest.raises(ConfigurationError, match="camera is 'image_02'"):
        KittiOdometry(kitti_odometry_root, camera="image_02")


def test_incomplete_and_damaged_frames(kitti_odometry_root: Path) -> None:
    folder = kitti_odometry_root / "sequences" / "00"
    (folder / "velodyne/000001.bin").unlink()
    (folder / "velodyne/000002.bin").write_bytes(b"")
    recording = KittiOdometry(kitti_odometry_root, sequences=["00"])
    rig = recording.frame_ids[0].rig
    assert list(recording.skipped) == [str(FrameId(rig, "00", 1))]
    with pytest.raises(FrameError, match=r"000002.bin: 0 bytes"):
        recording.load(recording.frame_ids[-1])


def test_missing_root_says_where_to_get_the_data(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        KittiOdometry(tmp_path / "nowhere")
    message = str(caught.value)
    assert "nowhere does not exist" in message
    assert "https://www.cvlibs.net/datasets/kitti/eval_odometry.php" in message
    assert "sequences/00/velodyne/000000.bin" in message
    assert "python -m uncal.simulate root=" in message


def test_wrong_root_says_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "dataset" / "sequences").mkdir(parents=True)
    with pytest.raises(RecordingError, match=f"give {tmp_path}/dataset"):
        KittiOdometry(tmp_path)
    with pytest.raises(RecordingError, match=r"no folder such as 00; found nothing"):
        KittiOdometry(tmp_path / "dataset")
    with pytest.raises(RecordingError, match=r"no folder 'sequences'; found nothing"):
        KittiOdometry(tmp_path / "dataset" / "sequences")
