"""What a network sees: made from a batch on the device, after the decalibration is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uncal.data.dataset import Batch
from uncal.decalibration import decalibrate
from uncal.errors import ConfigurationError
from uncal.events.representations import EventRepresentation
from uncal.projection import project
from uncal.recordings.frame import FrameId

CAMERAS: tuple[str, ...] = ("rgb", "events")
"""What a camera may give; a recording offers one of them."""

CHANNELS: tuple[str, ...] = (*CAMERAS, "inverse_depth", "intensity")
"""The inputs that a model can ask for."""


class NetworkInput(NamedTuple):
    """One decalibrated batch.

    Attributes:
        x: (B, C, H, W) the channels that the model asked for, normalised.
        inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection; 0 where no point falls.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics, the ones the projection used.
        target: (B, 6) the decalibration to be found, metres and radians.
        place: (B,) int64 numbers of the frames in their split.
        frames: the frames.
    """

    x: Tensor
    inverse_depth: Tensor
    K: Tensor
    T_init: Tensor
    target: Tensor
    place: Tensor
    frames: list[FrameId]


@dataclass(frozen=True, kw_only=True)
class InputSettings:
    """What a network reads, and how it is scaled, so that each channel is of order one.

    Attributes:
        channels: names out of :data:`CHANNELS`, in the order of the network's input.
        inverse_depth_scale: metres; multiplies inverse depth.
        intensity_scale: multiplies reflectance.
        camera_channels: how many channels the camera has: 3, or as many as ``events`` draws.
        rgb_mean: subtracted from RGB in 0..1.
        rgb_std: divides RGB after that.
        events: draws the events; None for a network that reads none.
        events_scale: multiplies what it draws.
    """

    channels: Sequence[str]
    inverse_depth_scale: float
    intensity_scale: float
    camera_channels: int = 3
    rgb_mean: float = 0.0
    rgb_std: float = 1.0
    events: EventRepresentation | None = None
    events_scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the channels.

        Raises:
            ConfigurationError: a channel is unknown, none is asked for, or they contradict the
                other settings.
        """
        asked = f"model.inputs.channels={list(self.channels)}"
        unknown = [name for name in self.channels if name not in CHANNELS]
        if unknown or not self.channels:
            raise ConfigurationError(f"{asked}: expected names out of {list(CHANNELS)}")
        if {*CAMERAS} <= {*self.channels}:
            raise ConfigurationError(f"{asked}: a frame has rgb or events, never both")
        if self.camera == "events" and self.events is None:
            raise ConfigurationError(
                f"{asked}: model.inputs.events is missing; choose model/inputs=events_lidar"
            )
        wanted = 3 if self.camera == "rgb" else self.events.channels if self.events else None
        if wanted not in (None, self.camera_channels):
            raise ConfigurationError(
                f"model.inputs.camera_channels={self.camera_channels}: expected {wanted}, as many "
                f"as {self.camera} has"
            )

    @property
    def camera(self) -> str | None:
        """Which of :data:`CAMERAS` the network reads; None for one that is blind."""
        return next((name for name in self.channels if name in CAMERAS), None)

    @property
    def n_channels(self) -> int:
        """C of the network's input."""
        return sum(self.camera_channels if name in CAMERAS else 1 for name in self.channels)


def make_input(batch: Batch, decalibration: Tensor, settings: InputSettings) -> NetworkInput:
    """Decalibrate, project and normalise a batch where it lies.

    Args:
        batch: B samples, on any device.
        decalibration: (B, 6) metres and radians.
        settings: channels and scales.

    Returns:
        The network's input and target.

    Raises:
        ConfigurationError: the network reads rgb and the batch holds events, or the reverse.
    """
    T_init = decalibrate(batch.T_cam_lidar, decalibration)
    size = (batch.camera.shape[-2], batch.camera.shape[-1])
    projection = project(batch.points, T_init, batch.K, size)
    parts = []
    for name in settings.channels:
        if name in CAMERAS:
            parts.append(_camera(batch.camera, settings))
        elif name == "inverse_depth":
            parts.append(projection.inverse_depth * settings.inverse_depth_scale)
        else:
            parts.append(projection.intensity * settings.intensity_scale)
    x = torch.cat(parts, 1)
    return NetworkInput(
        x, projection.inverse_depth, batch.K, T_init, decalibration, batch.place, batch.frames
    )


def _camera(camera: Tensor, settings: InputSettings) -> Tensor:
    """(B, C, H, W) float32 channels of the camera."""
    held = "rgb" if camera.dtype == torch.uint8 else "events"
    if settings.camera != held:
        raise ConfigurationError(
            f"the model reads {settings.camera}, but the recording's frames hold {held}"
        )
    if held == "events":
        return camera.float() * settings.events_scale
    return (camera.float() / 255.0 - settings.rgb_mean) / settings.rgb_std
