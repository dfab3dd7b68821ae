"""The label: what a decalibration is, how it is drawn, applied and undone. Nowhere else.

The assumed extrinsic is the true one after a small motion D of the LiDAR in its own frame,
``T_init = T_cam_lidar · D``. A network estimates the 6-vector of D; ``T_est = T_init · D̂⁻¹``.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import torch
from torch import Tensor

from uncal.geometry import invert, pose_to_matrix
from uncal.settings.group import SettingsGroup
from uncal.settings.rules import number


@dataclass(frozen=True)
class DecalibrationRange(SettingsGroup):
    """Uniform decalibrations, independent per axis (the paper: ±1°, ±10 cm).

    Attributes:
        rotation_deg: bound of |roll|, |pitch| and |yaw|, degrees.
        translation_cm: bound of |x|, |y| and |z|, centimetres.
    """

    key: ClassVar[str] = "decalibration"
    rotation_deg: Annotated[float, number(0, 45, above=True)]
    translation_cm: Annotated[float, number(0, 1000, above=True)]

    @property
    def rotation(self) -> float:
        """Bound of each Euler angle, radians."""
        return math.radians(self.rotation_deg)

    @property
    def translation(self) -> float:
        """Bound of each translation, metres."""
        return self.translation_cm / 100.0

    @property
    def bounds(self) -> Tensor:
        """(6,) bounds in the order of :data:`uncal.geometry.DOF_NAMES`, metres and radians."""
        return torch.tensor([self.translation] * 3 + [self.rotation] * 3)

    def draw(self, n: int, device: torch.device | str = "cpu") -> Tensor:
        """(n, 6) in metres and radians from torch's global generator, as training does."""
        return (2.0 * torch.rand(n, 6, device=device) - 1.0) * self.bounds.to(device)

    def draw_for(self, seed: int, frame: str) -> Tensor:
        """(6,) float32 of one frame: a pure function of its arguments, on any machine.

        >>> r = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
        >>> bool((r.draw_for(0, "a") == r.draw_for(0, "a")).all())
        True
        >>> bool((r.draw_for(0, "a") == r.draw_for(1, "a")).any())
        False
        """
        digest = hashlib.sha256(f"{seed}|{frame}".encode()).digest()
        generator = np.random.Generator(np.random.Philox(int.from_bytes(digest[:16], "little")))
        unit = torch.from_numpy(generator.uniform(-1.0, 1.0, 6).astype(np.float32))
        return unit * self.bounds


def decalibrate(T_cam_lidar: Tensor, decalibration: Tensor) -> Tensor:
    """The wrong (..., 4, 4) extrinsic that a (..., 6) decalibration, metres and radians, leaves.

    ``T_init = T_cam_lidar · D``
    """
    return T_cam_lidar @ pose_to_matrix(decalibration)


def correct(T_init: Tensor, estimate: Tensor) -> Tensor:
    """The (..., 4, 4) extrinsic after taking a (..., 6) estimate, m and rad, out: ``T_init · D̂⁻¹``.

    >>> T = pose_to_matrix(torch.tensor([0.1, 0.2, 0.3, 0.0, 0.1, 0.2]))
    >>> d = torch.tensor([0.05, -0.02, 0.0, 0.01, 0.0, -0.01])
    >>> torch.allclose(correct(decalibrate(T, d), d), T, atol=1e-6)
    True
    """
    return T_init @ invert(pose_to_matrix(estimate))
