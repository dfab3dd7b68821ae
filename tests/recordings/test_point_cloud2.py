from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.recordings.point_cloud2 import brightest_of, read_points, sweep_end

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
    flat = layout({"x": ("<f4", 0), "y": ("<f4", 4), "intensity": ("<f4", 8)}, 12)
    with pytest.raises(ValueError, match="no field z; it has x, y, intensity"):
        read_points(make_cloud(np.zeros(3, flat)))
    cloud = make_cloud(make_scan(7))
    cloud.fields[0].offset = 20
    with pytest.raises(ValueError, match="field x ends at byte 24 of a point of 22"):
        read_points(cloud)


def test_without_intensity_the_reflectance_is_zero(make_cloud: MakeCloud) -> None:
    dim = np.ones(3, layout({"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8)}, 12))
    cloud = make_cloud(dim)
    points, n_dropped = read_points(cloud, brightest_of(cloud))
    assert points.tolist() == [[1, 1, 1, 0]] * 3
    assert n_dropped == 0


@pytest.mark.parametrize(
    ("kind", "values", "reflectance"),
    [
        ("<u2", [0, 6553.5, 65535], [0, 0.1, 1]),
        ("<f4", [0, 300, 65535], [0, 300 / 65535, 1]),
        ("<u2", [0, 51, 255], [0, 0.2, 1]),
        ("<f4", [np.nan, 51, 255], [0.2, 1]),
    ],
)
def test_intensities_of_sixteen_bits_are_scaled_by_their_own_range(
    make_cloud: MakeCloud, kind: str, values: list[float], reflectance: list[float]
) -> None:
    fields = {"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8), "intensity": (kind, 12)}
    scan = np.ones(len(values), layout(fields, 16))
    scan["intensity"] = np.asarray(values).astype(kind)
    cloud = make_cloud(scan)
    points, _ = read_points(cloud, brightest_of(cloud))
    np.testing.assert_allclose(points[:, 3], reflectance, atol=1e-5)


def test_an_organised_cloud_may_leave_its_row_step_zero(make_cloud: MakeCloud) -> None:
    """16 × 1024 with NaN where nothing came back, fields out of the order of their offsets."""
    dtype = layout(
        {"z": ("<f4", 8), "intensity": ("<f4", 16), "x": ("<f4", 0), "y": ("<f4", 4)}, 22
    )
    scan = np.ones(16 * 1024, dtype)
    scan["x"] = np.arange(scan.size)
    scan["z"][::2] = np.nan
    cloud = make_cloud(scan, rows=16)
    cloud.row_step = 0
    points, n_dropped = read_points(cloud)
    assert n_dropped == scan.size // 2
    np.testing.assert_array_equal(points[:, 0], np.arange(1, scan.size, 2))


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
