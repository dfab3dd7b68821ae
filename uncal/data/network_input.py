"""What a network sees: made from a batch on the device, after the decalibration is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.data.dataset import Batch
from uncal.errors import ConfigurationError
from uncal.events.representations import EventRepresentation
from uncal.geometry.decalibration import decalibrate
from uncal.geometry.projection import project
from uncal.recordings.frame import FrameId

CAMERAS: tuple[str, ...] = ("rgb", "events")
"""What a camera may give; a recording has one of them."""

CHANNELS: tuple[str, ...] = (*CAMERAS, "inverse_depth", "intensity")
"""The inputs that a model can ask for."""


class NetworkInput(NamedTuple):
    """One decalibrated batch.

    Attributes:
        x: (B, C, H, W) the channels that the model asked for, normalised.
        inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection; 0 where no point falls.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics, the ones the projection used.
        target: (n, 6) the decalibration to be found of each unit, metres and radians.
        unit_index: (n,) int64 numbers of the units in their split.
        frames: the B frames.
        unit: (B,) int64 which of the n units of :mod:`uncal.splits.windows` each frame belongs to.
        edges: (B, M, columns) edges of the sweeps; rows of NaN pad.
    """

    x: Tensor
    inverse_depth: Tensor
    K: Tensor
    T_init: Tensor
    target: Tensor
    unit_index: Tensor
    frames: list[FrameId]
    unit: Tensor
    edges: Tensor


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
        edges: most edges of a sweep that the network is given; 0: it reads none.
        train_edges: how many of them in training, which cost time there; 0: all.
    """

    channels: Sequence[str]
    inverse_depth_scale: float
    intensity_scale: float
    camera_channels: int = 3
    rgb_mean: float = 0.0
    rgb_std: float = 1.0
    events: EventRepresentation | None = None
    events_scale: float = 1.0
    edges: int = 0
    train_edges: int = 0

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
    """Decalibrate by (n, 6) of each unit, project and normalise a batch where it lies.

    Raises:
        ConfigurationError: the network reads rgb and the batch holds events, or the reverse.
    """
    in_training = batch.decalibration is None and settings.train_edges > 0
    T_init = decalibrate(batch.T_cam_lidar, decalibration[batch.unit])
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
        x=x,
        inverse_depth=projection.inverse_depth,
        K=batch.K,
        T_init=T_init,
        target=decalibration,
        unit_index=batch.unit_index,
        frames=batch.frames,
        unit=batch.unit,
        edges=padded(batch.edges, settings.train_edges if in_training else settings.edges),
    )


def padded(edges: Tensor, rows: int) -> Tensor:
    """(B, m, columns) edges in a fixed number of rows, so that no shape depends on the batch."""
    edges = edges[:, :rows]
    missing = rows - edges.shape[1]
    return F.pad(edges, (0, 0, 0, missing), value=float("nan")) if missing else edges


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
