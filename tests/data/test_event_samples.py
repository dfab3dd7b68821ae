"""Frames of events through the same path as images: size, camera matrix, cache, skipping."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.data.dataset import FrameDataset, Sample, SkippedFrame, collate
from uncal.data.image_size import fit, resize_and_crop
from uncal.events.representations import EventRepresentation, Histogram, VoxelGrid
from uncal.events.stream import Events, PixelMap
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.frame import Frame, FrameId
from uncal.splits.windows import units_of

K = np.array([[90.0, 0.0, 51.3], [0.0, 88.0, 29.1], [0.0, 0.0, 1.0]])
T = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
SENSOR = (60, 104)


def events_at(
    x: NDArray[np.floating], y: NDArray[np.floating], size: tuple[int, int] = SENSOR
) -> Events:
    t = np.linspace(0, 999, len(x)).astype(np.int64)
    sign = np.arange(len(x)) % 3 == 0
    return Events(x.astype(np.float32), y.astype(np.float32), t, sign, (0, 1000), size)


class Scripted:
    """A recording of windows of events; frame 1 has nothing of a camera."""

    skipped: dict[str, str]

    def __init__(self) -> None:
        self.frame_ids = [FrameId("rig", "drive", i) for i in range(3)]
        self.skipped = {}

    def load(self, frame_id: FrameId) -> Frame:
        rng = np.random.default_rng(frame_id.index)
        events = events_at(rng.uniform(0, 104, 3000), rng.uniform(0, 60, 3000))
        points = rng.uniform([4, -3, -2, 0], [30, 3, 2, 1], (200, 4)).astype(np.float32)
        return Frame(
            frame_id, None, points, K, T, 0.0, events=None if frame_id.index == 1 else events
        )


class Counting:
    """Counts how often it draws; can draw numbers that half precision does not have."""

    channels = 2

    def __init__(self, factor: float = 1.0) -> None:
        self.calls = 0
        self.factor = factor

    def __call__(self, events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
        self.calls += 1
        return self.factor * Histogram(normalize=False)(events, size, pixel_map)


def dataset(events: EventRepresentation | None, cache: bool = False) -> FrameDataset:
    recording = Scripted()
    decalibration = DecalibrationRange(1.0, 10.0)
    units = units_of(recording.frame_ids, 1)
    return FrameDataset(recording, units, (32, 48), decalibration, 0, cache, events)


def sample(subject: FrameDataset, index: int) -> Sample:
    (made,) = subject[index]
    assert isinstance(made, Sample)
    return made


@pytest.mark.parametrize("size", [(32, 48), (33, 100), (60, 104), (80, 208), (192, 640), (7, 9)])
@pytest.mark.parametrize("source", [(60, 104), (480, 640), (375, 1242)])
def test_images_and_events_get_the_same_camera_matrix(
    source: tuple[int, int], size: tuple[int, int]
) -> None:
    how = fit(source, size)
    image, K_image = resize_and_crop(np.zeros((*source, 3), np.uint8), K, how, size)
    assert image.shape == (*size, 3)
    np.testing.assert_array_equal(how.camera_matrix(K), K_image)
    # K and the map are one: a point's pixel, mapped, is its pixel under the new camera matrix.
    u, v, _ = K @ [0.3, -0.2, 1.0]
    to, moved = how.pixel_map, K_image @ [0.3, -0.2, 1.0]
    np.testing.assert_allclose([to.sx * u + to.ox, to.sy * v + to.oy], moved[:2], atol=1e-9)


@pytest.mark.parametrize("size", [(30, 52), (24, 60), (45, 70), (90, 120)])
def test_events_land_where_the_image_has_their_pixels(size: tuple[int, int]) -> None:
    rows, columns = np.mgrid[0:60, 0:104]
    blob = np.exp(-((rows - 33.0) ** 2 + (columns - 61.0) ** 2) / 30.0)
    shown = np.repeat((250 * blob)[..., None], 3, 2).astype(np.uint8)
    image, _ = resize_and_crop(shown, K, fit(SENSOR, size), size)
    many = np.repeat(np.arange(blob.size), (40 * blob).astype(int).ravel())
    events = events_at(columns.ravel()[many], rows.ravel()[many])
    drawn = VoxelGrid(bins=1, normalize=False)(events, size, fit(SENSOR, size).pixel_map)
    np.testing.assert_allclose(centre(drawn[0].abs().numpy()), centre(image[..., 0]), atol=0.15)


def centre(picture: NDArray[np.generic]) -> list[float]:
    weight = picture.astype(float)
    rows, columns = np.mgrid[0 : weight.shape[0], 0 : weight.shape[1]]
    return [float((axis * weight).sum() / weight.sum()) for axis in (rows, columns)]


def test_a_sample_has_the_tensor_at_the_networks_size() -> None:
    made = sample(dataset(VoxelGrid(4, True)), 0)
    assert made.camera.shape == (4, 32, 48)
    assert made.camera.dtype == torch.float16
    events = Scripted().load(made.frame).events
    assert events is not None
    drawn = VoxelGrid(4, True)(events, (32, 48), fit(SENSOR, (32, 48)).pixel_map)
    assert torch.equal(made.camera, drawn.half())
    np.testing.assert_allclose(made.K, fit(SENSOR, (32, 48)).camera_matrix(K), rtol=1e-6)
    assert 0 < len(made.points) <= 200


def test_drawn_once_when_cached() -> None:
    counting = Counting()
    cached = dataset(counting, cache=True)
    assert cached[0] is cached[0]
    assert counting.calls == 1
    plain = dataset(counting)
    assert torch.equal(sample(plain, 0).camera, sample(cached, 0).camera)
    assert counting.calls == 2


def test_counts_beyond_half_precision_stay_finite() -> None:
    camera = sample(dataset(Counting(1e6)), 0).camera
    assert camera.max() == torch.finfo(torch.float16).max


def test_a_frame_without_camera_data_is_skipped_with_its_reason() -> None:
    (skipped,) = dataset(Histogram(True))[1]
    assert isinstance(skipped, SkippedFrame)
    assert "neither an image nor events" in skipped.reason


def test_a_network_that_reads_no_events_gets_none() -> None:
    batch = collate([dataset(None)[0], dataset(None)[2]])
    assert batch.camera.shape == (2, 0, 32, 48)


@pytest.mark.parametrize("representation", [VoxelGrid(5, True), Histogram(True)])
def test_mirroring_the_tensor_mirrors_the_events(representation: EventRepresentation) -> None:
    rng = np.random.default_rng(0)
    events = events_at(rng.uniform(0, 103, 2000), rng.uniform(0, 59, 2000))
    flipped = events_at(103.0 - events.x, events.y)
    to = fit(SENSOR, (30, 52)).pixel_map
    plain, mirrored = (representation(e, (30, 52), to) for e in (events, flipped))
    # Events exactly between two pixels may round to the other side.
    assert torch.isclose(plain.flip(-1), mirrored, atol=1e-3).float().mean() > 0.99
