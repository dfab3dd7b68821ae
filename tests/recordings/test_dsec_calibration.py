from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import event_camera_calibration

WriteCalibration = Callable[..., None]
Matrix = NDArray[np.float64]


def pose(euler_deg: tuple[float, float, float], position: tuple[float, float, float]) -> Matrix:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", euler_deg, degrees=True).as_matrix()
    T[:3, 3] = position
    return T


# Where each thing is in the world: T_world_cam of the four cameras and of the LiDAR, and the
# rotation from each camera to its rectified one.
WORLD_CAM = [
    pose((1, 2, 3), (0.10, 0.00, 0.0)),
    pose((-2, 1, 0.5), (0.15, 0.01, -0.02)),
    pose((0.5, -1, 2), (0.65, 0.02, 0.01)),
    pose((2, 0.3, -1), (0.71, -0.01, 0.0)),
]
WORLD_LIDAR = pose((91, 3, 88), (0.3, -0.4, -0.2))
RECTIFICATION = [pose(euler, (0, 0, 0)) for euler in ((1, 0, 2), (0, 3, 1), (2, 1, 0), (-1, 2, 1))]


def between(to: int, source: int) -> Matrix:
    T: Matrix = np.linalg.inv(WORLD_CAM[to]) @ WORLD_CAM[source]
    return T


def write_rig(folder: Path, write_calibration: WriteCalibration) -> tuple[Path, Path]:
    extrinsics = {
        **{f"T_{i + 1}{i}": between(i + 1, i).tolist() for i in range(3)},
        **{f"R_rect{i}": RECTIFICATION[i][:3, :3].tolist() for i in range(4)},
    }
    write_calibration(folder, extrinsics=extrinsics)
    T_rect1_lidar = RECTIFICATION[1] @ np.linalg.inv(WORLD_CAM[1]) @ WORLD_LIDAR
    lidar = {"T_lidar_camRect1": np.linalg.inv(T_rect1_lidar).tolist()}
    (folder / "cam_to_lidar.yaml").write_text(yaml.safe_dump(lidar))
    return folder / "cam_to_cam.yaml", folder / "cam_to_lidar.yaml"


@pytest.mark.parametrize(("side", "number", "fx"), [("left", 0, 5), ("right", 3, 8)])
def test_a_world_point_lands_on_the_same_pixel_either_way(
    tmp_path: Path, write_calibration: WriteCalibration, side: str, number: int, fx: float
) -> None:
    calibration = event_camera_calibration(*write_rig(tmp_path, write_calibration), side)
    np.testing.assert_array_equal(calibration.K, [[fx, 0, 3.5], [0, fx + 1, 2.5], [0, 0, 1]])
    world = np.array([0.7, -0.3, 9.0, 1.0])
    # Directly: world → camera → rectified camera.
    in_camera = RECTIFICATION[number] @ np.linalg.inv(WORLD_CAM[number]) @ world
    # Through the files: world → LiDAR → rectified camera.
    in_lidar = np.linalg.inv(WORLD_LIDAR) @ world
    through_files = calibration.T_cam_lidar @ in_lidar
    np.testing.assert_allclose(through_files, in_camera, atol=1e-12)
    pixel = calibration.K @ through_files[:3]
    np.testing.assert_allclose(
        pixel[:2] / pixel[2],
        [
            fx * in_camera[0] / in_camera[2] + 3.5,
            (fx + 1) * in_camera[1] / in_camera[2] + 2.5,
        ],
    )


def test_axis_parallel_rig_by_hand(tmp_path: Path, write_calibration: WriteCalibration) -> None:
    write_calibration(tmp_path, lidar_x=0.4)
    files = tmp_path / "cam_to_cam.yaml", tmp_path / "cam_to_lidar.yaml"
    # The frame camera is 0.4 m ahead of the LiDAR; cam0 is 5 cm to its left (x_cam1 = x_cam0 -
    # 0.05), cam3 10 cm to its right by the file's convention (x_cam3 = x_cam1 - 0.1).
    left = event_camera_calibration(*files).T_cam_lidar @ [10.4, 2.0, 1.0, 1.0]
    np.testing.assert_allclose(left, [-2.0 + 0.05, -1.0, 10.0, 1.0])
    right = event_camera_calibration(*files, "right").T_cam_lidar @ [10.4, 2.0, 1.0, 1.0]
    np.testing.assert_allclose(right, [-2.0 - 0.1, -1.0, 10.0, 1.0])


def test_numbers_that_yaml_takes_for_words_are_numbers(
    tmp_path: Path, write_calibration: WriteCalibration
) -> None:
    files = write_rig(tmp_path, write_calibration)
    expected = event_camera_calibration(*files).T_cam_lidar
    text = files[1].read_text().replace("- - 0.0\n", "- - 0e-05\n").replace("- 1.0\n", "- 1e00\n")
    assert "1e00" in text
    files[1].write_text(text)
    np.testing.assert_array_equal(event_camera_calibration(*files).T_cam_lidar, expected)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cam_to_cam.yaml", "camRect0", "camRectO", r"no key 'intrinsics.camRect0'; keys there: "),
        ("cam_to_cam.yaml", "T_10", "T_01", r"no key 'extrinsics.T_10'"),
        ("cam_to_cam.yaml", "- 5.0", "- .nan", r"camera_matrix' is .*expected finite numbers"),
        ("cam_to_cam.yaml", "- 5.0", "- -5.0", r"fx = -5.0"),
        ("cam_to_cam.yaml", "intrinsics:", "intrinsics: [", r"is no YAML file"),
        ("cam_to_lidar.yaml", "T_lidar_camRect1", "T_lidar_cam1", r"keys there: T_lidar_cam1"),
        ("cam_to_lidar.yaml", "- - 0\n  - -1", "- - 0\n  - -2", r"is not a rotation"),
        ("cam_to_lidar.yaml", "  - 1\n- - -1", "  - 1\n  - 7\n- - -1", r"shape \(4, 4\)"),
    ],
)
def test_damaged_file_is_named_with_its_key(
    tmp_path: Path,
    write_calibration: WriteCalibration,
    name: str,
    old: str,
    new: str,
    message: str,
) -> None:
    write_calibration(tmp_path)
    text = (tmp_path / name).read_text()
    if name == "cam_to_lidar.yaml":
        text = "T_lidar_camRect1:\n- - 0\n  - 0\n  - 1\n  - 1\n- - -1\n  - 0\n  - 0\n  - 0\n"
        text += "- - 0\n  - -1\n  - 0\n  - 0\n- - 0\n  - 0\n  - 0\n  - 1\n"
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(RecordingError, match=message):
        event_camera_calibration(tmp_path / "cam_to_cam.yaml", tmp_path / "cam_to_lidar.yaml")


def test_missing_file(tmp_path: Path, write_calibration: WriteCalibration) -> None:
    write_calibration(tmp_path)
    with pytest.raises(RecordingError, match="Cannot read the calibration file"):
        event_camera_calibration(tmp_path / "cam_to_cam.yaml", tmp_path / "none.yaml")
