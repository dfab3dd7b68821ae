from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped]
import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.errors import FrameError, RecordingError
from uncal.recordings.dsec_events import EventFile, inspect_events, read_rectify_map

WriteEvents = Callable[..., None]
OFFSET = 50_000_000_000
HEIGHT, WIDTH = 6, 8


def opened(folder: Path) -> EventFile:
    return inspect_events(folder / "events.h5", read_rectify_map(folder / "rectify_map.h5"))


@pytest.fixture
def times() -> NDArray[np.int64]:
    """2000 events of 100 ms, denser and denser, with repeated microseconds and empty ms."""
    t = np.sort(np.random.default_rng(0).integers(0, 100_000, 2000))
    t = t[(t < 30_000) | (t >= 35_000)]
    t[0] = 0
    return t.astype(np.int64)


@pytest.mark.parametrize(("coordinate", "time"), [("u2", "u4"), ("i4", "i8"), ("u2", "u8")])
@pytest.mark.parametrize(
    ("start", "end"),
    [(0, 1000), (10_000, 20_000), (1_234, 5_678), (28_500, 36_500), (31_000, 34_000), (90_000, -1)],
)
def test_window_holds_exactly_its_events(
    tmp_path: Path,
    write_events: WriteEvents,
    times: NDArray[np.int64],
    coordinate: str,
    time: str,
    start: int,
    end: int,
) -> None:
    write_events(tmp_path, times, OFFSET, coordinate=coordinate, time=time)
    file = opened(tmp_path)
    assert (file.first_us, file.end_us, file.t_offset) == (0, times[-1] + 1, OFFSET)
    end = file.end_us if end < 0 else end
    events = file.read(start, end)
    (inside,) = np.nonzero((times >= start) & (times < end))
    x, y = inside % WIDTH, inside // WIDTH % HEIGHT
    np.testing.assert_array_equal(events.t, times[inside] + OFFSET)
    np.testing.assert_array_equal(events.x, x + 0.25 * y - 0.5)
    np.testing.assert_array_equal(events.y, 1.5 * y - 0.125 * x)
    np.testing.assert_array_equal(events.p, inside % 3 == 0)
    assert events.window == (start + OFFSET, end + OFFSET)
    assert events.size == (HEIGHT, WIDTH)
    assert [a.dtype for a in (events.x, events.y, events.t, events.p)] == ["f4", "f4", "i8", "?"]


def test_upper_bounds_are_the_events_of_the_touched_milliseconds(
    tmp_path: Path, write_events: WriteEvents, times: NDArray[np.int64]
) -> None:
    write_events(tmp_path, times, OFFSET)
    file = opened(tmp_path)
    starts = np.array([0, 10_300, 31_000, 90_000])
    ends = np.array([1000, 12_100, 34_000, file.end_us])
    bounds = file.count_at_most(starts, ends)
    touched = [(0, 1000), (10_000, 13_000), (31_000, 34_000), (90_000, 100_000)]
    assert bounds.tolist() == [np.sum((times >= a) & (times < b)) for a, b in touched]
    exact = [len(file.read(int(a), int(b))) for a, b in zip(starts, ends, strict=True)]
    assert (bounds >= exact).all()


def test_reads_no_more_than_the_milliseconds_of_the_window(
    tmp_path: Path, write_events: WriteEvents, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.arange(0, 1_000_000, 20)  # 50 per ms
    write_events(tmp_path, t, OFFSET)
    read: dict[str, int] = {}
    real = h5py.Dataset.__getitem__

    def counting(dataset: Any, key: Any, **options: Any) -> Any:  # noqa: ANN401  # h5py's own
        values = real(dataset, key, **options)
        name = str(dataset.name)
        read[name] = read.get(name, 0) + np.size(values)
        return values

    monkeypatch.setattr(h5py.Dataset, "__getitem__", counting)
    file = opened(tmp_path)
    file.count_at_most(np.array([0]), np.array([900_000]))
    assert read == {
        "/rectify_map": 2 * HEIGHT * WIDTH,
        "/ms_to_idx": 2000,
        "/events/t": 2,
        "/t_offset": 1,
    }
    read.clear()
    assert len(file.read(400_500, 420_500)) == 1000
    assert read == {
        "/ms_to_idx": 2,
        "/events/t": 21 * 50,
        "/events/x": 1000,
        "/events/y": 1000,
        "/events/p": 1000,
    }


@pytest.mark.parametrize("name", ["events.h5", "rectify_map.h5"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_truncated_file_is_refused(
    tmp_path: Path, write_events: WriteEvents, times: NDArray[np.int64], name: str, share: float
) -> None:
    write_events(tmp_path, times, OFFSET)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=rf"{name} cannot be read .*truncated or damaged"):
        opened(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(RecordingError, match=f"{name} is missing"):
        opened(tmp_path)


def edit(folder: Path, name: str, values: NDArray[np.generic] | None) -> None:
    with h5py.File(folder / "events.h5", "a") as file:
        del file[name]
        if values is not None:
            file[name] = values


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("ms_to_idx", None, "ms_to_idx"),
        ("t_offset", None, "t_offset"),
        ("events/p", np.zeros(3), "expected one length above 0"),
        ("ms_to_idx", np.array([0, 9, 3]), "does not rise"),
        ("ms_to_idx", np.array([0, 10**9]), "does not rise"),
    ],
)
def test_file_of_another_layout_is_refused(
    tmp_path: Path,
    write_events: WriteEvents,
    times: NDArray[np.int64],
    name: str,
    values: NDArray[np.generic] | None,
    message: str,
) -> None:
    write_events(tmp_path, times, OFFSET)
    edit(tmp_path, name, values)
    with pytest.raises(RecordingError, match=message):
        opened(tmp_path)


def test_contradictions_in_a_window_are_frame_errors(
    tmp_path: Path, write_events: WriteEvents, times: NDArray[np.int64]
) -> None:
    write_events(tmp_path, times, OFFSET)
    file = opened(tmp_path)
    with h5py.File(tmp_path / "events.h5") as h5:
        right = h5["ms_to_idx"][:]
        x = h5["events/x"][:]
    edit(tmp_path, "ms_to_idx", right // 2)
    with pytest.raises(FrameError, match="ms_to_idx points elsewhere"):
        file.read(50_000, 60_000)
    edit(tmp_path, "ms_to_idx", right)
    edit(tmp_path, "events/x", x + 640)
    with pytest.raises(FrameError, match=r"x 640\.\.647, .* 8×6 pixels"):
        file.read(50_000, 60_000)
    edit(tmp_path, "events/x", x)
    assert len(file.read(50_000, 60_000)) > 0
    content = bytearray((tmp_path / "events.h5").read_bytes())
    content[800:-800] = bytes(len(content) - 1600)
    (tmp_path / "events.h5").write_bytes(content)
    with pytest.raises(FrameError, match="damaged"):
        file.read(50_000, 60_000)


def test_span_ends_where_ms_to_idx_ends(
    tmp_path: Path, write_events: WriteEvents, times: NDArray[np.int64]
) -> None:
    write_events(tmp_path, times, OFFSET)
    with h5py.File(tmp_path / "events.h5") as h5:
        half = h5["ms_to_idx"][:50]
    edit(tmp_path, "ms_to_idx", half)
    file = opened(tmp_path)
    assert file.end_us == 49_000
    assert len(file.read(40_000, 49_000)) == np.sum((times >= 40_000) & (times < 49_000))


def test_rectification_map_of_another_shape_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "rectify_map.h5", "w") as file:
        file["rectify_map"] = np.zeros((2, 6, 8))
    with pytest.raises(RecordingError, match=r"shape \(2, 6, 8\), expected"):
        read_rectify_map(tmp_path / "rectify_map.h5")
