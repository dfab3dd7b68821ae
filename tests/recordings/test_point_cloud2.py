from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.recordings.point_cloud2 import read_points, sweep_end

MakeScan = Callable[..., NDArray[np.void]]
MakeCloud = Callable[..., Any]


def layout(formats: dict[str, tuple[str, int]], size: int) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": list(formats),
            "formats": [kind for kind, _ in formats.values()],
            "offsets": [offset for _, offset in formats.values()],
            "itemsize": size,
        }
    )


EXPECTED = np.array(
    [[7, 1, -2, 0], [7, 2, -2, 0.2], [7, 3, -2, 0.4], [7, 4, -2, 0.6], [7, 5, -2, 1]]
)


@pytest.mark.parametrize(
    "dtype",
    [
        layout({"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8), "intensity": ("<f4", 16)}, 32),
        layout({"intensity": ("<u1", 3), "z": ("<f4", 4), "x": ("<f4", 9), "y": ("<f4", 13)}, 17),
        layout({"y": ("<f8", 0), "x": ("<f8", 8), "intensity": ("<u2", 16), "z": ("<f8", 18)}, 26),
        layout({"x": (">f4", 0), "y": (">f4", 4), "z": (">f8", 8), "intensity": (">i4", 16)}, 22),
        layout({"x": ("<i4", 0), "y": ("<i2", 4), "z": ("<i1", 6), "intensity": ("<u4", 8)}, 12),
    ],
    ids=["padded", "shuffled", "double", "big endian", "integers"],
)
def test_fields_are_where_the_message_says(
    make_scan: MakeScan, make_cloud: MakeCloud, dtype: np.dtype[np.void]
) -> None:
    points, n_dropped = read_points(make_cloud(make_scan(7, dtype)))
    np.testing.assert_allclose(points, EXPECTED, rtol=1e-6)
    assert points.dtype == np.float32
    assert n_dropped == 0


def test_rows_may_have_a_gap_between_them(make_scan: MakeScan, make_cloud: MakeCloud) -> None:
    both = np.concatenate([make_scan(7), make_scan(8)])
    points, _ = read_points(make_cloud(both, rows=2, gap=10))
    np.testing.assert_array_equal(points[:, 0], [7] * 5 + [8] * 5)
    np.testing.assert_array_equal(points[5:, 1], [1, 2, 3, 4, 5])


def test_points_that_are_not_finite_are_dropped_and_counted(
    make_scan: MakeScan, make_cloud: MakeCloud
) -> None:
    scan = make_scan(7)
    scan["y"][1], scan["intensity"][4] = np.nan, np.inf
    points, n_dropped = read_points(make_cloud(scan))
    np.testing.assert_array_equal(points[:, 1], [1, 3, 4])
    assert n_dropped == 2


def test_short_and_incomplete_messages_are_refused(
    make_scan: MakeScan, make_cloud: MakeCloud
) -> None:
    cloud = make_cloud(make_scan(7))
    cloud.data = cloud.data[:-1]
    with pytest.raises(ValueError, match=r"holds 109 bytes .* 1×5 points of 22 bytes"):
        read_points(cloud)
    dim = layout({"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8)}, 12)
    with pytest.raises(ValueError, match="no field intensity; it has x, y, z"):
        read_points(make_cloud(np.zeros(3, dim)))
    cloud = make_cloud(make_scan(7))
    cloud.fields[0].offset = 20
    with pytest.raises(ValueError, match="field x ends at byte 24 of a point of 22"):
        read_points(cloud)


@pytest.mark.parametrize(
    ("times", "end"),
    [
        ([0, 0.03, 0.09, np.nan, 0.1], 0.1),  # stamp of the first packet
        ([-0.1, -0.05, -0.02, -0.01, 0.001], 0.001),  # stamp of the last one
        ([0, 1e6, 2e6, 3e6, 1e8], 0),  # no seconds
        ([np.nan] * 5, 0),
    ],
)
def test_end_of_the_sweep(
    make_scan: MakeScan, make_cloud: MakeCloud, times: list[float], end: float
) -> None:
    scan = make_scan(7)
    scan["time"] = times
    assert sweep_end(make_cloud(scan)) == pytest.approx(end)


def test_without_times_the_sweep_ends_at_its_stamp(
    make_scan: MakeScan, make_cloud: MakeCloud
) -> None:
    dtype = layout(
        {"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8), "intensity": ("<f4", 12)}, 16
    )
    assert sweep_end(make_cloud(make_scan(7, dtype))) == 0
