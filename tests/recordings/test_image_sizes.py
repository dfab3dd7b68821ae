"""An image of another size than its calibration is for is no frame: its K would be wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]

from uncal.errors import FrameError
from uncal.recordings.dsec import Dsec
from uncal.recordings.kitti import KittiRaw
from uncal.recordings.kitti_odometry import KittiOdometry
from uncal.recordings.sensor_files import image_size, read_image, usual_size


def write(path: Path, *shape: int, dtype: type = np.uint8, value: int = 7) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full(shape, value, dtype=dtype))


def test_a_crop_among_the_images_of_a_drive_is_refused_with_both_sizes(
    kitti_raw_root: Path,
) -> None:
    drive = "2011_09_26_drive_0001_sync"
    write(kitti_raw_root / "2011_09_26" / drive / "image_02/data/0000000001.png", 20, 60, 3)
    recording = KittiRaw(kitti_raw_root, drives=[drive])
    with pytest.raises(FrameError, match=r"0000000001\.png: 60×20 .*S_rect.* 80×24"):
        recording.load(recording.frame_ids[1])
    assert recording.load(recording.frame_ids[2]).image is not None


def test_a_drive_that_was_resized_as_a_whole_is_refused_too(kitti_raw_root: Path) -> None:
    drive = "2011_09_26_drive_0002_sync"
    for path in (kitti_raw_root / "2011_09_26" / drive / "image_02/data").glob("*.png"):
        write(path, 12, 40, 3)
    recording = KittiRaw(kitti_raw_root, drives=[drive])
    for frame_id in recording.frame_ids:
        with pytest.raises(FrameError, match="its camera matrix does not hold"):
            recording.load(frame_id)


def test_without_a_size_in_the_calibration_the_drive_itself_is_the_measure(
    kitti_odometry_root: Path,
) -> None:
    # The first of three: a recording must not take the odd one for the rule.
    write(kitti_odometry_root / "sequences/00/image_2/000000.png", 20, 60, 3)
    recording = KittiOdometry(kitti_odometry_root, sequences=["00"])
    with pytest.raises(FrameError, match=r"000000\.png: 60×20 .*most others have 80×24"):
        recording.load(recording.frame_ids[0])
    assert recording.load(recording.frame_ids[1]).image is not None


def test_drives_of_different_sizes_live_side_by_side(kitti_odometry_root: Path) -> None:
    for path in (kitti_odometry_root / "sequences/03/image_2").glob("*.png"):
        write(path, 22, 76, 3)
    recording = KittiOdometry(kitti_odometry_root)
    sizes = {frame_id.drive: recording.load(frame_id).image for frame_id in recording.frame_ids}
    assert {drive: image.shape for drive, image in sizes.items() if image is not None} == {
        "00": (24, 80, 3),
        "01": (24, 80, 3),
        "03": (22, 76, 3),
    }


def test_a_map_of_another_resolution_than_the_calibration_leaves_the_sequence_out(
    dsec_root: Path,
) -> None:
    path = dsec_root / "sim_00_a" / "calibration" / "cam_to_cam.yaml"
    content = yaml.safe_load(path.read_text())
    for camera in content["intrinsics"].values():
        camera["resolution"] = [640, 480]
    path.write_text(yaml.safe_dump(content))
    recording = Dsec(dsec_root, 40.0, 10)
    assert {frame_id.drive for frame_id in recording.frame_ids} == {"sim_00_b", "sim_01_a"}
    assert "is for 8×6 pixels" in recording.skipped["sim_00_a"]
    assert "resolution 640×480" in recording.skipped["sim_00_a"]


def test_sizes_come_from_the_header(tmp_path: Path) -> None:
    write(tmp_path / "a.png", 5, 7, 3)
    assert image_size(tmp_path / "a.png") == (5, 7)
    (tmp_path / "b.png").write_bytes(b"no image at all, but long enough")
    assert image_size(tmp_path / "b.png") is None
    assert image_size(tmp_path / "none.png") is None
    assert usual_size([tmp_path / "b.png"]) is None
    assert usual_size([]) is None


@pytest.mark.parametrize(
    ("shape", "dtype", "value", "expected"),
    [
        ((4, 6), np.uint16, 0x7F33, 0x7F),
        ((4, 6, 3), np.uint16, 0xFFFF, 0xFF),
        ((4, 6, 4), np.uint8, 9, 9),
        ((4, 6, 4), np.uint16, 0x0900, 9),
        ((4, 6), np.uint8, 9, 9),
    ],
)
def test_depth_and_transparency_are_converted(
    tmp_path: Path, shape: tuple[int, ...], dtype: type, value: int, expected: int
) -> None:
    write(tmp_path / "a.png", *shape, dtype=dtype, value=value)
    image = read_image(tmp_path / "a.png")
    assert image.shape == (4, 6, 3)
    assert image.dtype == np.uint8
    assert set(image.ravel().tolist()) == {expected}


def test_another_depth_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    cv2.imwrite(str(path), np.ones((4, 6), np.float32))
    with pytest.raises(FrameError, match=r"1 channels of float32, expected .* 8 or 16 bits"):
        read_image(path)
