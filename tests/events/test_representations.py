from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.events import representations
from uncal.events.representations import EventRepresentation, Histogram, TimeSurface, VoxelGrid
from uncal.events.stream import Events, PixelMap

Row = tuple[float, float, int, int]
"""x, y, t, p."""

SIZE = (3, 4)
WINDOW = (1_000, 2_000)
SAME = PixelMap.identity()
ALL: list[EventRepresentation] = [
    Histogram(normalize=False),
    Histogram(normalize=True),
    VoxelGrid(bins=1, normalize=False),
    VoxelGrid(bins=5, normalize=False),
    VoxelGrid(bins=5, normalize=True),
    TimeSurface(tau_us=300.0),
]


def events_of(rows: Sequence[Row], window: tuple[int, int] = WINDOW) -> Events:
    x, y, t, p = np.array(rows, np.float64).reshape(-1, 4).T
    return Events(
        x.astype(np.float32),
        y.astype(np.float32),
        t.astype(np.int64),
        p.astype(bool),
        window,
        SIZE,
    )


def random_events(n: int, seed: int = 0, margin: float = 2.0) -> Events:
    """Events in and around an image of 3 × 4, of fractional coordinates."""
    rng = np.random.default_rng(seed)
    return Events(
        rng.uniform(-margin, SIZE[1] - 1 + margin, n).astype(np.float32),
        rng.uniform(-margin, SIZE[0] - 1 + margin, n).astype(np.float32),
        np.sort(rng.integers(*WINDOW, n)),
        rng.random(n) < 0.4,
        WINDOW,
        SIZE,
    )


def image_of(cells: dict[tuple[int, int, int], float], channels: int) -> Tensor:
    image = torch.zeros(channels, *SIZE)
    for cell, value in cells.items():
        image[cell] = value
    return image


def histogram_by_loop(events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
    image = torch.zeros(2, *size)
    for x, y, p in zip(events.x, events.y, events.p, strict=True):
        column = math.floor(pixel_map.sx * float(x) + pixel_map.ox + 0.5)
        row = math.floor(pixel_map.sy * float(y) + pixel_map.oy + 0.5)
        if 0 <= column < size[1] and 0 <= row < size[0]:
            image[int(p), row, column] += 1
    return image


def voxel_grid_by_loop(
    events: Events, size: tuple[int, int], pixel_map: PixelMap, bins: int
) -> Tensor:
    """Every event against every cell, as the equation has it."""
    image = np.zeros((bins, *size))
    for x, y, t, p in zip(events.x, events.y, events.t, events.p, strict=True):
        u = pixel_map.sx * float(x) + pixel_map.ox
        v = pixel_map.sy * float(y) + pixel_map.oy
        b = (bins - 1) * (t - events.window[0]) / (events.window[1] - events.window[0])
        for cell in np.ndindex(image.shape):
            near = [
                max(0.0, 1.0 - abs(here - there))
                for here, there in zip(cell, (b, v, u), strict=True)
            ]
            image[cell] += (1.0 if p else -1.0) * math.prod(near)
    return torch.from_numpy(image).float()


def time_surface_by_loop(
    events: Events, size: tuple[int, int], pixel_map: PixelMap, tau_us: float
) -> Tensor:
    image = torch.zeros(2, *size)
    for x, y, t, p in zip(events.x, events.y, events.t, events.p, strict=True):
        column = math.floor(pixel_map.sx * float(x) + pixel_map.ox + 0.5)
        row = math.floor(pixel_map.sy * float(y) + pixel_map.oy + 0.5)
        if 0 <= column < size[1] and 0 <= row < size[0]:
            image[int(p), row, column] = math.exp(-(events.window[1] - int(t)) / tau_us)
    return image


def test_histogram_by_hand() -> None:
    rows: list[Row] = [
        (1.0, 2.0, 1000, 1),
        (1.4, 1.6, 1001, 1),
        (0.6, 2.4, 1002, 1),
        (1.0, 2.0, 1003, 0),
        (-0.5, -0.5, 1004, 0),
        (3.49, 0.0, 1999, 1),
    ]
    expected = {(1, 2, 1): 3.0, (0, 2, 1): 1.0, (0, 0, 0): 1.0, (1, 0, 3): 1.0}
    image = Histogram(normalize=False)(events_of(rows), SIZE, SAME)
    assert torch.equal(image, image_of(expected, 2))


def test_normalised_histogram_by_hand() -> None:
    rows: list[Row] = [*[(0.0, 0.0, 1000, 1)] * 7, (1.0, 0.0, 1000, 0)]
    image = Histogram(normalize=True)(events_of(rows), SIZE, SAME)
    # The root mean square of 7 and 1 is 5.
    assert torch.allclose(image, image_of({(1, 0, 0): 1.4, (0, 0, 1): 0.2}, 2))


def test_voxel_grid_by_hand() -> None:
    # Five bins over 1000 µs lie 250 µs apart; t = 1300 is a fifth of the way from bin 1 to bin 2.
    rows: list[Row] = [(2.0, 1.0, 1000, 0), (0.25, 1.5, 1300, 1)]
    expected = {(0, 1, 2): -1.0}
    for b, in_time in ((1, 0.8), (2, 0.2)):
        for column, in_columns in ((0, 0.75), (1, 0.25)):
            for row in (1, 2):
                expected[b, row, column] = in_time * in_columns * 0.5
    image = VoxelGrid(bins=5, normalize=False)(events_of(rows), SIZE, SAME)
    assert torch.allclose(image, image_of(expected, 5), atol=1e-6)
    assert torch.equal(image != 0, image_of(expected, 5) != 0)


def test_an_event_beside_the_image_leaves_in_it_what_reaches_in() -> None:
    rows: list[Row] = [(-0.25, 0.0, 1000, 1), (3.75, 2.5, 1000, 1)]
    image = VoxelGrid(bins=2, normalize=False)(events_of(rows), SIZE, SAME)
    assert torch.allclose(image, image_of({(0, 0, 0): 0.75, (0, 2, 3): 0.125}, 2))


def test_one_bin_leaves_time_out() -> None:
    rows: list[Row] = [(0, 0, 1000, 1), (0, 0, 1999, 1), (1, 0, 1500, 0)]
    image = VoxelGrid(bins=1, normalize=False)(events_of(rows), SIZE, SAME)
    assert torch.equal(image, image_of({(0, 0, 0): 2.0, (0, 0, 1): -1.0}, 1))


def test_time_surface_by_hand() -> None:
    rows: list[Row] = [(1, 1, 1200, 1), (1, 1, 1400, 1), (1.2, 0.8, 1700, 0), (2, 2, 1999, 0)]
    expected = {
        (1, 1, 1): math.exp(-2.0),
        (0, 1, 1): math.exp(-1.0),
        (0, 2, 2): math.exp(-1 / 300),
    }
    image = TimeSurface(tau_us=300.0)(events_of(rows), SIZE, SAME)
    assert torch.allclose(image, image_of(expected, 2))


def test_a_time_surface_a_thousand_time_constants_old_is_zero() -> None:
    image = TimeSurface(tau_us=1.0)(events_of([(1, 1, 1000, 1)]), SIZE, SAME)
    assert torch.equal(image, torch.zeros(2, *SIZE))


@pytest.mark.parametrize("bins", [1, 2, 15])
def test_events_inside_weigh_one_each(bins: int) -> None:
    events = random_events(5_000, margin=0.0)
    image = VoxelGrid(bins, normalize=False)(events, SIZE, SAME)
    assert float(image.sum()) == pytest.approx(events.p.sum() - (~events.p).sum(), abs=0.02)
    brighter = Events(events.x, events.y, events.t, np.ones(5_000, bool), WINDOW, SIZE)
    image = VoxelGrid(bins, normalize=False)(brighter, SIZE, SAME)
    assert float(image.sum()) == pytest.approx(5_000, abs=0.02)
    assert (image >= 0).all()


def test_swapping_polarity_swaps_signs_and_channels() -> None:
    events = random_events(200)
    swapped = Events(events.x, events.y, events.t, ~events.p, WINDOW, SIZE)
    voxels, histogram = VoxelGrid(5, normalize=False), Histogram(normalize=False)
    assert torch.equal(voxels(swapped, SIZE, SAME), -voxels(events, SIZE, SAME))
    assert torch.equal(histogram(swapped, SIZE, SAME), histogram(events, SIZE, SAME).flip(0))


def test_the_normalised_grid_is_standard_where_it_is_not_zero() -> None:
    # Eight events leave most of the cells at zero.
    events = random_events(8, seed=1, margin=0.0)
    raw = VoxelGrid(5, normalize=False)(events, SIZE, SAME)
    image = VoxelGrid(5, normalize=True)(events, SIZE, SAME)
    occupied = raw[raw != 0]
    assert 5 < len(occupied) < raw.numel() - 5
    expected = (occupied - occupied.mean()) / occupied.std(correction=0)
    assert torch.allclose(image[raw != 0], expected, atol=1e-5)
    assert (image[raw == 0] == 0).all()


def test_equal_cells_are_normalised_to_zero() -> None:
    rows: list[Row] = [(column, row, 1_000, 1) for column in (0.0, 2.0) for row in (0.0, 1.0)]
    for kept in (rows[:1], rows * 7):
        image = VoxelGrid(5, normalize=True)(events_of(kept), SIZE, SAME)
        assert image.abs().max() < 1e-5


@pytest.mark.parametrize("representation", ALL, ids=str)
def test_no_events_give_zeros(representation: EventRepresentation) -> None:
    for events in (
        events_of([]),
        events_of([], window=(5, 5)),
        events_of([(1, 1, 999, 1), (1, 1, 2_000, 1)]),
        events_of([(-3, 0, 1500, 1), (0, 4.5, 1500, 0), (1e30, -1e30, 1500, 0)]),
    ):
        image = representation(events, SIZE, SAME)
        assert image.dtype == torch.float32
        assert torch.equal(image, torch.zeros(representation.channels, *SIZE))


@pytest.mark.parametrize("representation", ALL, ids=str)
def test_coordinates_that_are_not_finite_and_other_times_are_ignored(
    representation: EventRepresentation,
) -> None:
    good: list[Row] = [(1.25, 1.5, 1300, 1), (2.0, 0.5, 1700, 0)]
    bad: list[Row] = [
        (math.nan, 1.0, 1400, 1),
        (1.0, math.nan, 1400, 0),
        (math.nan, math.nan, 1400, 0),
        (math.inf, 1.0, 1500, 1),
        (1.0, -math.inf, 1500, 1),
    ]
    early: list[Row] = [(1, 1, 999, 1)]
    late: list[Row] = [(1, 1, 2000, 1)]
    mixed = events_of([*early, good[0], *bad, good[1], *late])
    image = representation(mixed, SIZE, SAME)
    assert torch.isfinite(image).all()
    assert torch.equal(image, representation(events_of(good), SIZE, SAME))
    assert image.any()


@pytest.mark.parametrize(
    "pixel_map",
    [SAME, PixelMap(0.5, -0.25, 0.5, -0.25), PixelMap(1.7, -2.0, 1.3, 0.6)],
    ids=["same", "half", "scaled and cropped"],
)
@pytest.mark.parametrize("size", [SIZE, (2, 6)], ids=str)
def test_as_a_loop_over_the_events(pixel_map: PixelMap, size: tuple[int, int]) -> None:
    events = random_events(300, seed=2)
    image = Histogram(normalize=False)(events, size, pixel_map)
    assert torch.equal(image, histogram_by_loop(events, size, pixel_map))
    image = TimeSurface(300.0)(events, size, pixel_map)
    assert torch.allclose(image, time_surface_by_loop(events, size, pixel_map, 300.0))
    image = VoxelGrid(4, normalize=False)(events, size, pixel_map)
    expected = voxel_grid_by_loop(events, size, pixel_map, bins=4)
    assert torch.allclose(image, expected, atol=1e-5)


@pytest.mark.parametrize("representation", ALL, ids=str)
def test_the_number_of_events_at_a_time_does_not_matter(
    representation: EventRepresentation, monkeypatch: pytest.MonkeyPatch
) -> None:
    events = random_events(100, seed=3)
    whole = representation(events, SIZE, SAME)
    for chunk in (1, 7, 100):
        monkeypatch.setattr(representations, "CHUNK", chunk)
        assert torch.allclose(representation(events, SIZE, SAME), whole, atol=1e-5)


def test_the_map_is_that_of_resizing_and_cropping() -> None:
    # Halved, pixels 2 and 3 become pixel 1; the crop takes one column, so it is column 0.
    half = PixelMap(0.5, -0.25 - 1.0, 0.5, -0.25)
    rows: list[Row] = [(2, 0, 1000, 1), (3, 1, 1000, 1), (1, 0, 1000, 1), (4, 2, 1000, 1)]
    image = Histogram(normalize=False)(events_of(rows), (2, 2), half)
    assert image[1].tolist() == [[2.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize("bins", [0, -3, 2.0, True, None])
def test_bins_must_be_a_positive_number(bins: int) -> None:
    with pytest.raises(ConfigurationError, match=rf"bins={bins!r}: expected"):
        VoxelGrid(bins, normalize=True)


@pytest.mark.parametrize("tau_us", [0.0, -1.0, math.inf, math.nan])
def test_the_time_constant_must_be_positive(tau_us: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"tau_us={tau_us!r}: expected"):
        TimeSurface(tau_us)


def test_each_is_an_event_representation_with_its_channels() -> None:
    assert [representation.channels for representation in ALL] == [2, 2, 1, 5, 5, 2]
    assert all(isinstance(representation, EventRepresentation) for representation in ALL)


def test_events_that_may_not_be_written_to_are_read_without_a_warning(
    recwarn: pytest.WarningsRecorder,
) -> None:
    events = random_events(10)
    for array in (events.x, events.y, events.t, events.p):
        array.flags.writeable = False
    before = events.x.copy(), events.y.copy(), events.t.copy()
    for representation in ALL:
        representation(events, SIZE, SAME)
    assert not list(recwarn)
    np.testing.assert_array_equal(events.x, before[0])
    np.testing.assert_array_equal(events.y, before[1])
    np.testing.assert_array_equal(events.t, before[2])
