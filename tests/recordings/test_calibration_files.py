from __future__ import annotations

from pathlib import Path

import numpy as np
import pykitti  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import (
    odometry_calibration,
    raw_calibration,
    read_calibration_file,
)


def pykitti_raw_calibration(date_folder: Path) -> dict[str, NDArray[np.float64]]:
    """What pykitti makes of a date folder; its constructor would want a drive's IMU files too."""
    reader = object.__new__(pykitti.raw)
    reader.calib_path = str(date_folder)
    reader._load_calib()
    return dict(reader.calib._asdict())


def assert_chain_is_pykittis(date_folder: Path, camera: int) -> None:
    oracle = pykitti_raw_calibration(date_folder)
    projection = oracle[f"P_rect_{camera}0"]
    calibration = raw_calibration(date_folder, camera)

    np.testing.assert_array_equal(calibration.K, oracle[f"K_cam{camera}"])
    # KITTI's definition of the projection, from pykitti's parts.
    np.testing.assert_allclose(
        calibration.K @ calibration.T_cam_lidar[:3],
        projection @ oracle["R_rect_00"] @ oracle["T_cam0_velo_unrect"],
        atol=1e-9,
    )
    # pykitti's own extrinsic takes b_x = P[0, 3] / P[0, 0] for the camera's whole offset.
    offset = np.linalg.solve(projection[:, :3], projection[:, 3])
    left_out = np.eye(4)
    left_out[:3, 3] = offset - np.array([projection[0, 3] / projection[0, 0], 0.0, 0.0])
    T_cam_velo = oracle[f"T_cam{camera}_velo"]
    np.testing.assert_allclose(calibration.T_cam_lidar, left_out @ T_cam_velo, atol=1e-12)
    np.testing.assert_allclose(calibration.T_cam_lidar, T_cam_velo, atol=0.005)
    if camera < 2:
        np.testing.assert_allclose(calibration.T_cam_lidar, T_cam_velo, atol=1e-12)


@pytest.mark.parametrize("camera", [0, 1, 2, 3])
@pytest.mark.parametrize("date", ["2011_09_26", "2011_09_28"])
def test_raw_chain_is_pykittis(kitti_raw_root: Path, date: str, camera: int) -> None:
    assert_chain_is_pykittis(kitti_raw_root / date, camera)


@pytest.mark.kitti
@pytest.mark.parametrize("camera", [0, 1, 2, 3])
def test_raw_chain_is_pykittis_on_real_calibration(kitti_root: Path, camera: int) -> None:
    for date_folder in sorted(kitti_root.glob("????_??_??")):
        assert_chain_is_pykittis(date_folder, camera)


@pytest.mark.parametrize("camera", [0, 1, 2, 3])
def test_odometry_chain_is_pykittis(kitti_odometry_root: Path, camera: int) -> None:
    oracle = pykitti.odometry(str(kitti_odometry_root), "03").calib
    path = kitti_odometry_root / "sequences" / "03" / "calib.txt"
    calibration = odometry_calibration(path, camera)
    projection = getattr(oracle, f"P_rect_{camera}0")

    np.testing.assert_array_equal(calibration.K, getattr(oracle, f"K_cam{camera}"))
    np.testing.assert_allclose(
        calibration.K @ calibration.T_cam_lidar[:3], projection @ oracle.T_cam0_velo, atol=1e-9
    )
    atol = 1e-12 if camera < 2 else 0.005
    np.testing.assert_allclose(
        calibration.T_cam_lidar, getattr(oracle, f"T_cam{camera}_velo"), atol=atol
    )


def test_chain_by_hand(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text(
        "P0: 10 0 5 0 0 20 4 0 0 0 1 0\n"
        "P2: 10 0 5 20.5 0 20 4 2.4 0 0 1 0.1\n"
        "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 -0.3\n"
    )
    calibration = odometry_calibration(tmp_path / "calib.txt", 2)
    # b = ((20.5 - 5 · 0.1) / 10, (2.4 - 4 · 0.1) / 20, 0.1); x forward becomes z, less 0.3 m.
    np.testing.assert_allclose(
        calibration.T_cam_lidar,
        np.array([[0, -1, 0, 2], [0, 0, -1, 0.1], [1, 0, 0, -0.2], [0, 0, 0, 1.0]]),
        atol=1e-12,
    )


def test_lines_that_are_not_numbers_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("calib_time: 09-Jan-2012 13:57:47\n\nT: 1 -2.5e-1 3\nno colon\n")
    values = read_calibration_file(path)
    assert values["T"].tolist() == [1.0, -0.25, 3.0]
    assert "calib_time" not in values
    assert "no colon" not in values


def test_missing_file_is_named(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / "calib_velo_to_cam.txt"
    path.unlink()
    with pytest.raises(RecordingError, match=r"calib_velo_to_cam\.txt"):
        raw_calibration(path.parent, 2)


def test_missing_key_is_named(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / "calib_cam_to_cam.txt"
    path.write_text(path.read_text().replace("P_rect_02", "P_roct_02"))
    with pytest.raises(RecordingError, match=r"calib_cam_to_cam.txt has no key 'P_rect_02'"):
        raw_calibration(path.parent, 2)


def test_truncated_key_is_named(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / "calib_velo_to_cam.txt"
    path.write_text("R: 1 0 0 0 1 0 0 0\nT: 0 0 0\n")
    with pytest.raises(
        RecordingError, match=r"'R' is .* expected finite numbers of shape \(3, 3\)"
    ):
        raw_calibration(path.parent, 2)


@pytest.mark.parametrize("rotation", ["1 0 0 0 1 0 0 0 0.9", "1 0 0 0 1 0 0 0 -1"])
def test_damaged_rotation_is_refused(kitti_raw_root: Path, rotation: str) -> None:
    path = kitti_raw_root / "2011_09_26" / "calib_velo_to_cam.txt"
    path.write_text(f"R: {rotation}\nT: 0 0 0\n")
    with pytest.raises(RecordingError, match="'R' is not a rotation"):
        raw_calibration(path.parent, 2)


def test_damaged_camera_matrix_is_refused(kitti_raw_root: Path) -> None:
    path = kitti_raw_root / "2011_09_26" / "calib_cam_to_cam.txt"
    path.write_text(path.read_text() + "P_rect_02: 0 0 0 0 0 0 0 0 0 0 0 0\n")
    with pytest.raises(RecordingError, match="no camera matrix"):
        raw_calibration(path.parent, 2)


def test_odometry_without_tr_says_where_it_is(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("P0: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(RecordingError, match=r"no key 'Tr'.*data_odometry_calib.zip"):
        odometry_calibration(path, 0)
