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
from uncal.projection import project
from uncal.recordings.frame import FrameId

CHANNELS: dict[str, int] = {"rgb": 3, "inverse_depth": 1, "intensity": 1}
"""The inputs that a model can ask for, and how many channels each has."""


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


@dataclass(frozen=True)
class InputSettings:
    """How the channels are scaled, so that each is of order one.

    Attributes:
        channels: names out of :data:`CHANNELS`, in the order of the network's input.
        rgb_mean: subtracted from RGB in 0..1.
        rgb_std: divides RGB after that.
        inverse_depth_scale: metres; multiplies inverse depth.
        intensity_scale: multiplies reflectance.
    """

    channels: Sequence[str]
    rgb_mean: float
    rgb_std: float
    inverse_depth_scale: float
    intensity_scale: float

    def __post_init__(self) -> None:
        """Check the channel names.

        Raises:
            ConfigurationError: a channel is unknown or none is asked for.
        """
        unknown = [name for name in self.channels if name not in CHANNELS]
        if unknown or not self.channels:
            raise ConfigurationError(
                f"model.inputs.channels={list(self.channels)}: expected names out of "
                f"{list(CHANNELS)}"
            )

    @property
    def n_channels(self) -> int:
        """C of the network's input."""
        return sum(CHANNELS[name] for name in self.channels)


def make_input(batch: Batch, decalibration: Tensor, settings: InputSettings) -> NetworkInput:
    """Decalibrate, project and normalise a batch where it lies.

    Args:
        batch: B samples, on any device.
        decalibration: (B, 6) metres and radians.
        settings: channels and scales.

    Returns:
        The network's input and target.
    """
    T_init = decalibrate(batch.T_cam_lidar, decalibration)
    size = (batch.image.shape[-2], batch.image.shape[-1])
    projection = project(batch.points, T_init, batch.K, size)
    parts = []
    for name in settings.channels:
        if name == "rgb":
            parts.append((batch.image.float() / 255.0 - settings.rgb_mean) / settings.rgb_std)
        elif name == "inverse_depth":
            parts.append(projection.inverse_depth * settings.inverse_depth_scale)
        else:
            parts.append(projection.intensity * settings.intensity_scale)
    x = torch.cat(parts, 1)
    return NetworkInput(
        x, projection.inverse_depth, batch.K, T_init, decalibration, batch.place, batch.frames
    )
