from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uncal.errors import FrameError
from uncal.recordings.sensor_files import (
    read_clock_times,
    read_image,
    read_scan,
    read_second_times,
)


def test_image_is_rgb(tmp_path: Path) -> None:
    path = tmp_path / "red.png"
    cv2.imwrite(str(path), np.full((2, 3, 3), (0, 10, 255), dtype=np.uint8))
    image = read_image(path)
    assert image.dtype == np.uint8
    assert image.shape == (2, 3, 3)
    assert image[1, 2].tolist() == [255, 10, 0]


def test_grey_image_gets_three_channels(tmp_path: Path) -> None:
    path = tmp_path / "grey.png"
    cv2.imwrite(str(path), np.full((2, 3), 77, dtype=np.uint8))
    assert read_image(path).tolist() == np.full((2, 3, 3), 77).tolist()


@pytest.mark.parametrize("keep", [0, 100, -40, -5])
def test_truncated_image_is_named(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "0000000003.png"
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    cv2.imwrite(str(path), noise)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FrameError, match=r"0000000003.png: not a readable image"):
        read_image(path)


def test_missing_image_is_named(tmp_path: Path) -> None:
    with pytest.raises(FrameError, match=r"nowhere\.png: cannot be read"):
        read_image(tmp_path / "nowhere.png")


def test_scan_is_read_as_written(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    written = np.arange(12, dtype=np.float32).reshape(3, 4)
    written.tofile(path)
    points, n_dropped = read_scan(path)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, written)
    assert n_dropped == 0
    points[0, 0] = 5.0  # torch.from_numpy wants a writable array


@pytest.mark.parametrize("size", [0, 15, 47])
def test_truncated_scan_states_its_size(tmp_path: Path, size: int) -> None:
    path = tmp_path / "0000000007.bin"
    path.write_bytes(b"\0" * size)
    with pytest.raises(FrameError, match=rf"0000000007.bin: {size} bytes, .* multiple of 16"):
        read_scan(path)


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    written = np.ones((4, 4), dtype=np.float32)
    written[1, 0], written[3, 3] = np.nan, np.inf
    written.tofile(path)
    points, n_dropped = read_scan(path)
    np.testing.assert_array_equal(points, np.ones((2, 4)))
    assert n_dropped == 2


def test_scan_without_a_finite_point_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"
    np.full((3, 4), np.nan, dtype=np.float32).tofile(path)
    with pytest.raises(FrameError, match="none of its 3 points is finite"):
        read_scan(path)


def test_clock_times(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_text("1970-01-02 00:00:01.250000000\n\nnot a time\n1970-01-01 00:00:02.5\n")
    np.testing.assert_array_equal(read_clock_times(path), [86401.25, np.nan, np.nan, 2.5])


def test_second_times(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_text("0.000000e+00\n1.036224e-01\n?\n")
    np.testing.assert_array_equal(read_second_times(path), [0.0, 0.1036224, np.nan])


def test_missing_times_are_no_times(tmp_path: Path) -> None:
    assert read_clock_times(tmp_path / "timestamps.txt").size == 0
    assert read_second_times(tmp_path / "times.txt").size == 0
