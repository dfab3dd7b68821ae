import pytest
import torch

from uncal.data.dataset import Batch
from uncal.data.network_input import InputSettings, make_input
from uncal.edges.sweep import COLUMNS
from uncal.errors import ConfigurationError
from uncal.events.representations import EventRepresentation, Histogram, VoxelGrid
from uncal.recordings.frame import FrameId

LIDAR = ["inverse_depth", "intensity"]


def settings(
    *camera: str, camera_channels: int = 3, events: EventRepresentation | None = None
) -> InputSettings:
    return InputSettings(
        channels=[*camera, *LIDAR],
        inverse_depth_scale=10.0,
        intensity_scale=2.0,
        camera_channels=camera_channels,
        events=events,
        events_scale=0.5,
    )


def batch(camera: torch.Tensor) -> Batch:
    n = len(camera)
    K = torch.tensor([[40.0, 0.0, 24.0], [0.0, 40.0, 16.0], [0.0, 0.0, 1.0]])
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return Batch(
        unit_index=torch.arange(n),
        unit=torch.arange(n),
        frames=[FrameId("rig", "drive", i) for i in range(n)],
        camera=camera,
        points=torch.tensor([[[10.0, 0.0, 0.0, 0.5]]]).repeat(n, 1, 1),
        edges=torch.empty(n, 0, len(COLUMNS)),
        K=K.repeat(n, 1, 1),
        T_cam_lidar=T.repeat(n, 1, 1),
        decalibration=None,
        skipped=[],
    )


def test_events_are_scaled_and_come_first() -> None:
    events = torch.randn(2, 5, 32, 48).half()
    subject = settings("events", camera_channels=5, events=VoxelGrid(5, True))
    x = make_input(batch(events), torch.zeros(2, 6), subject).x
    assert subject.n_channels == x.shape[1] == 7
    assert x.dtype == torch.float32
    assert torch.equal(x[:, :5], 0.5 * events.float())
    assert x[0, 5:, 16, 24].tolist() == pytest.approx([1.0, 1.0])  # 10 m / 10 m; 2 · 0.5


def test_the_camera_that_is_read_has_a_name() -> None:
    assert settings("rgb").camera == "rgb"
    assert settings("events", camera_channels=2, events=Histogram(True)).camera == "events"
    assert settings().camera is None
    assert settings().n_channels == 2


def test_a_network_without_a_camera_takes_any_frame() -> None:
    x = make_input(batch(torch.empty(1, 0, 32, 48)), torch.zeros(1, 6), settings()).x
    assert x.shape == (1, 2, 32, 48)


@pytest.mark.parametrize("camera", [torch.zeros(1, 2, 32, 48), torch.zeros(1, 0, 32, 48)])
def test_rgb_from_frames_of_events_is_refused(camera: torch.Tensor) -> None:
    with pytest.raises(ConfigurationError, match=r"reads rgb.*hold events"):
        make_input(batch(camera), torch.zeros(1, 6), settings("rgb"))


def test_events_from_images_are_refused() -> None:
    image = torch.zeros(1, 3, 32, 48, dtype=torch.uint8)
    subject = settings("events", camera_channels=2, events=Histogram(True))
    with pytest.raises(ConfigurationError, match=r"reads events.*hold rgb"):
        make_input(batch(image), torch.zeros(1, 6), subject)


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="thermal"):
        settings("thermal")
    with pytest.raises(ConfigurationError, match="never both"):
        settings("rgb", "events", events=Histogram(True))
    with pytest.raises(ConfigurationError, match="model/inputs=events_lidar"):
        settings("events")
    with pytest.raises(ConfigurationError, match=r"camera_channels=3: expected 2.*events"):
        settings("events", events=Histogram(True))
    with pytest.raises(ConfigurationError, match=r"camera_channels=4: expected 3.*rgb"):
        settings("rgb", camera_channels=4)
