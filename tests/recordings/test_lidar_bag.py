from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader

from uncal.errors import FrameError, RecordingError
from uncal.recordings import lidar_bag
from uncal.recordings.lidar_bag import LidarBag
from uncal.recordings.lidar_index import CACHE_NAME

MakeScan = Callable[..., NDArray[np.void]]
WriteBag = Callable[..., None]
START = 1_600_000_000_000_000_000
MS = 1_000_000


@pytest.fixture
def bag_path(tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag) -> Path:
    """Twelve scans at 20 Hz in several chunks; numbers 5 to 7 are missing."""
    path = tmp_path / "drive" / "lidar_imu.bag"
    numbers = [i for i in range(12) if i not in (5, 6, 7)]
    write_bag(path, [(START + 50 * MS * i, make_scan(i)) for i in numbers])
    return path


def test_finds_every_scan_between_the_other_topics(bag_path: Path) -> None:
    bag = LidarBag(bag_path)
    assert len(bag.index) == 9
    assert bag.index.n_points.tolist() == [5] * 9
    np.testing.assert_array_equal(bag.index.end_ns - bag.index.stamp_ns, [45 * MS] * 9)
    np.testing.assert_array_equal(bag.index.message_ns - bag.index.stamp_ns, [3 * MS] * 9)
    for position in (8, 0, 5, 5, 4):
        points, n_dropped = bag.read(position)
        assert points[0, 0] == [0, 1, 2, 3, 4, 8, 9, 10, 11][position]
        assert n_dropped == 0


@pytest.mark.parametrize("compression", ["LZ4", "BZ2"])
def test_reads_both_compressions(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag, compression: str
) -> None:
    path = tmp_path / "lidar_imu.bag"
    scans = [(START + 50 * MS * i, make_scan(i)) for i in range(4)]
    write_bag(path, scans, compression=compression)
    bag = LidarBag(path)
    assert [int(bag.read(i)[0][0, 0]) for i in range(len(bag.index))] == [0, 1, 2, 3]
    assert bag.intensity_note() == ""


def test_the_first_scan_says_how_bright_all_are(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    path = tmp_path / "lidar_imu.bag"
    bright, dark = make_scan(0), make_scan(1)
    bright["intensity"] = [0, 0, 0, 0, 65535]
    dark["intensity"] = [0, 0, 0, 0, 200]
    write_bag(path, [(START, bright), (START + 50 * MS, dark)])
    bag = LidarBag(path)
    assert bag.read(1)[0][4, 3] == pytest.approx(200 / 65535)
    assert bag.read(0)[0][4, 3] == 1
    assert bag.intensity_note() == "intensities beyond 255: read as 0 to 65535"


def test_scans_without_intensity_are_read_and_it_is_said(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    path = tmp_path / "lidar_imu.bag"
    fields = ["x", "y", "z", "ring", "time"]
    scan = make_scan(3)
    bare = np.empty(len(scan), [(name, scan.dtype[name]) for name in fields])
    for name in fields:
        bare[name] = scan[name]
    write_bag(path, [(START, bare)])
    bag = LidarBag(path)
    assert bag.read(0)[0][:, 3].tolist() == [0] * 5
    assert "no intensity" in bag.intensity_note()


def test_measures_the_rate_and_the_gaps(bag_path: Path) -> None:
    index = LidarBag(bag_path).index
    assert index.rate == pytest.approx(20)
    assert index.n_gaps == 1


def test_sorts_by_stamp_and_leaves_out_repetitions(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    path = tmp_path / "lidar_imu.bag"
    write_bag(path, [(START + 50 * MS * i, make_scan(i)) for i in (0, 2, 1, 2, 3)])
    bag = LidarBag(path)
    assert [int(bag.read(i)[0][0, 0]) for i in range(len(bag.index))] == [0, 1, 2, 3]
    assert bag.index.n_duplicates == 1


def test_index_is_kept_beside_the_bag_until_the_bag_changes(
    bag_path: Path, make_scan: MakeScan, write_bag: WriteBag, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = LidarBag(bag_path).index
    with monkeypatch.context() as patch:
        patch.setattr(lidar_bag, "index_scans", None)  # calling it would fail
        second = LidarBag(bag_path).index
    for name, value in vars(first).items():
        np.testing.assert_array_equal(value, vars(second)[name])
    bag_path.unlink()
    write_bag(bag_path, [(START, make_scan(3))])
    assert len(LidarBag(bag_path).index) == 1


def test_damaged_index_is_made_again(bag_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    LidarBag(bag_path)
    bag_path.with_name(CACHE_NAME).write_bytes(b"PK no zip")
    assert len(LidarBag(bag_path).index) == 9
    assert "ignoring the damaged index" in caplog.text


def test_index_stays_in_memory_where_the_folder_is_read_only(
    bag_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(np, "savez", refuse)
    with caplog.at_level(logging.INFO):
        assert len(LidarBag(bag_path).index) == 9
    assert "memory only" in caplog.text
    assert [path.name for path in bag_path.parent.iterdir()] == [bag_path.name]


def test_one_process_opens_the_bag_once_and_pickles_leave_it_closed(
    bag_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = LidarBag(bag_path)
    opened: list[Path] = []

    class CountingReader(Reader):
        def open(self) -> None:
            opened.append(bag_path)
            super().open()

    monkeypatch.setattr(lidar_bag, "Reader", CountingReader)
    bag.read(0)
    bag.read(3)
    assert len(opened) == 1
    copy = pickle.loads(pickle.dumps(bag))
    np.testing.assert_array_equal(copy.read(3)[0], bag.read(3)[0])
    assert len(opened) == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_bag_that_nobody_holds_is_closed(bag_path: Path) -> None:
    bag = LidarBag(bag_path)
    bag.read(0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ResourceWarning)
        del bag
        gc.collect()
    assert [str(each.message) for each in caught] == []


def test_forked_workers_read_at_the_same_time(bag_path: Path) -> None:
    bag = LidarBag(bag_path)
    bag.read(0)  # the parent's file is open when the workers start
    with multiprocessing.get_context("fork").Pool(2) as pool:
        first_x = pool.map(_first_x, [(bag, i % 9) for i in range(60)], chunksize=1)
    assert first_x == [[0, 1, 2, 3, 4, 8, 9, 10, 11][i % 9] for i in range(60)]


def _first_x(argument: tuple[LidarBag, int]) -> int:
    bag, position = argument
    return int(bag.read(position)[0][0, 0])


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_truncated_bag_is_refused_with_what_to_do(bag_path: Path, share: float) -> None:
    content = bag_path.read_bytes()
    bag_path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=r"lidar_imu\.bag is no complete ROS 1 bag .* again"):
        LidarBag(bag_path)


def test_missing_bag_and_missing_topic(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    with pytest.raises(RecordingError, match="no LiDAR recording at"):
        LidarBag(tmp_path / "lidar_imu.bag")
    write_bag(tmp_path / "lidar_imu.bag", [(START, make_scan(0))], topic="/velodyne_packets")
    with pytest.raises(RecordingError, match="its topics are /imu/data, /velodyne_packets"):
        LidarBag(tmp_path / "lidar_imu.bag")


def test_damaged_chunk_ends_the_reading_and_is_counted(bag_path: Path) -> None:
    content = bytearray(bag_path.read_bytes())
    middle = content.find(b"compression=lz4", len(content) // 2) + 40
    content[middle : middle + 60] = bytes(60)
    bag_path.write_bytes(content)
    index = LidarBag(bag_path).index
    assert 0 < len(index) < 9
    assert len(index) + index.n_damaged == 9
    assert f"damaged after {len(index)} scans" in index.damage


def test_empty_scans_are_counted(tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag) -> None:
    path = tmp_path / "lidar_imu.bag"
    write_bag(path, [(START, make_scan(0)[:0]), (START + 50 * MS, make_scan(1))])
    index = LidarBag(path).index
    assert (len(index), index.n_damaged, index.damage) == (1, 1, "the point cloud is empty")


def test_scan_without_a_finite_point_is_a_frame_error(
    tmp_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    scan = make_scan(0)
    scan["x"] = np.nan
    write_bag(tmp_path / "lidar_imu.bag", [(START, scan)])
    bag = LidarBag(tmp_path / "lidar_imu.bag")
    with pytest.raises(FrameError, match="none of the 5 points"):
        bag.read(0)


def test_bag_that_changes_under_the_reader_is_a_frame_error(
    bag_path: Path, make_scan: MakeScan, write_bag: WriteBag
) -> None:
    bag = LidarBag(bag_path)
    bag_path.unlink()
    write_bag(bag_path, [(START + MS, make_scan(0))])
    with pytest.raises(FrameError, match="has changed since it was indexed"):
        bag.read(0)
    bag_path.unlink()
    with pytest.raises(FrameError, match="cannot be read"):
        pickle.loads(pickle.dumps(bag)).read(0)
