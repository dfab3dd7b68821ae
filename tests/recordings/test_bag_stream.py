from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.bag_conversion import write_folder
from uncal.recordings.bag_stream import BagStream
from uncal.recordings.plain_folder import PlainFolder
from uncal.simulation.formats.bag import write_bag

T_CAM_LIDAR = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]])
K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])


def image(number: int) -> NDArray[np.uint8]:
    return np.full((48, 64, 3), (number, 100, 200), np.uint8)


def scan(number: int) -> NDArray[np.float32]:
    return np.array([[5.0 + number, 1, 0, 0.2], [np.nan, 0, 0, 0], [6, 0, 1, 1]], np.float32)


def images(*times: float) -> list[tuple[float, NDArray[np.uint8]]]:
    return [(time, image(number)) for number, time in enumerate(times)]


def scans(*times: float) -> list[tuple[float, NDArray[np.float32]]]:
    return [(time, scan(number)) for number, time in enumerate(times)]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_pairs_by_stamp_in_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("drive.bag" if kind == "ros1" else "drive")
    write_bag(path, images(10.0, 10.1, 10.2), scans(10.01, 10.15, 10.21), K, T_CAM_LIDAR, kind=kind)
    with BagStream(path, tolerance_s=0.02) as stream:
        seen = list(stream)
        assert stream.T_cam_lidar is not None
        np.testing.assert_allclose(stream.T_cam_lidar, T_CAM_LIDAR, atol=1e-9)
    assert [(round(s.time, 3), int(s.image[0, 0, 0])) for s in seen] == [(10.01, 0), (10.21, 2)]
    np.testing.assert_allclose(seen[1].points, scan(2)[[0, 2]], rtol=1e-6)
    assert seen[1].n_dropped == 1
    assert stream.counts == {"images": 3, "scans": 3, "pairs": 2, "scans without an image": 1,
                             "undistorted": 0}  # fmt: skip


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_compressed_chunks_of_a_first_bag(
    tmp_path: Path, compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Compressed(Writer):
        def __init__(self, path: Path) -> None:
            super().__init__(path)
            self.set_compression(self.CompressionFormat[compression])

    monkeypatch.setattr("uncal.simulation.formats.bag.Writer1", Compressed)
    path = tmp_path / "drive.bag"
    write_bag(path, images(10.0, 10.1), scans(10.01, 10.11), K, T_CAM_LIDAR, kind="ros1")
    assert f"compression={compression.lower()}".encode() in path.read_bytes()
    with BagStream(path, tolerance_s=0.02) as stream:
        assert [int(sample.image[0, 0, 0]) for sample in stream] == [0, 1]


def test_a_single_mcap_file_and_an_offset(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive", images(10.0, 10.1), scans(10.3, 10.4), K, T_CAM_LIDAR)
    (path,) = folder.glob("*.mcap")
    with BagStream(path, offset_s=0.3) as stream:
        assert [int(s.image[0, 0, 0]) for s in stream] == [0, 1]


def test_compressed_images_of_a_distorted_lens(tmp_path: Path) -> None:
    lens = ("plumb_bob", [-0.2, 0.05, 0.0, 0.0, 0.0])
    path = write_bag(
        tmp_path / "drive", images(1.0), scans(1.0), K, T_CAM_LIDAR, lens=lens, compressed=True
    )
    with BagStream(path) as stream:
        (seen,) = stream
        assert stream.counts["undistorted"] == 1
    assert seen.image.shape == (48, 64, 3)
    assert abs(seen.K[0, 0] - K[0, 0]) > 1.0
    assert seen.image[..., 1].min() > 90, "every pixel comes from the image"


def test_what_cannot_be_used_is_said(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "drive", images(1.0), scans(1.0), K, T_cam_lidar=None)
    with pytest.raises(ConfigurationError, match="/front/image_raw"):
        BagStream(path, image="/rear/image_raw")
    with BagStream(path) as stream:
        assert stream.T_cam_lidar is None
        with pytest.raises(ConfigurationError, match="extrinsic=FILE"):
            write_folder(stream, tmp_path / "root", "a", "front", "top", None)
    with pytest.raises(RecordingError, match="is no bag"):
        BagStream(tmp_path / "nothing.bag")
    bag = write_bag(tmp_path / "b.bag", images(1.0), scans(1.0), K, T_CAM_LIDAR, kind="ros1")
    bag.write_bytes(bag.read_bytes()[:-200])
    with pytest.raises(RecordingError, match="truncated"):
        BagStream(bag)


def test_the_plain_folder_has_what_the_bag_had(tmp_path: Path) -> None:
    root = tmp_path / "root"
    for name in ("a", "b"):
        path = write_bag(
            tmp_path / name, images(1.0, 1.1, 1.2), scans(1.0, 1.1, 1.2), K, T_CAM_LIDAR
        )
        with BagStream(path) as stream:
            write_folder(stream, root, name, "front", "top", stream.T_cam_lidar, progress=False)
    recording = PlainFolder(root)
    assert [frame.drive for frame in recording.frame_ids] == ["a"] * 3 + ["b"] * 3
    frame = recording.load(recording.frame_ids[2])
    np.testing.assert_allclose(frame.points, scan(2)[[0, 2]], rtol=1e-6)
    np.testing.assert_allclose(frame.T_cam_lidar, T_CAM_LIDAR, atol=1e-9)
    assert frame.image is not None
    assert frame.image[0, 0].tolist() == [2, 100, 200]
    assert frame.time == pytest.approx(1.2)
    other = write_bag(
        tmp_path / "c", images(1.0), scans(1.0), 2 * K + np.diag([0, 0, -1.0]), T_CAM_LIDAR
    )
    with BagStream(other) as stream, pytest.raises(ConfigurationError, match="another rig"):
        write_folder(stream, root, "c", "front", "top", stream.T_cam_lidar)
