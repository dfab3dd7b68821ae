"""A library of small tileable textures with mip levels, looked up for many samples at once.

Each texel holds two numbers: a *blend* between a surface's two colours (windows in a wall, paint on
asphalt, gaps between leaves) and a *grain* that makes both brighter or darker.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE_BITS = 7
SIZE = 1 << SIZE_BITS
"""Texels per side at full resolution; one repeat of a texture."""

VARIANTS = 8
"""Different textures of each kind."""

GRAIN_RANGE = (0.5, 1.5)
"""Brightness factors that the darkest and the brightest grain stand for."""

Image = NDArray[np.float32]


class Kind(IntEnum):
    """What a texture looks like; ``kind * VARIANTS + variant`` is its number."""

    PLAIN = 0
    ROUGH = 1
    FACADE = 2
    SHOPFRONT = 3
    MASONRY = 4
    SLATS = 5
    LEAVES = 6
    SIGN = 7
    DASHES = 8
    PATCHES = 9
    GLAZING = 10


@dataclass(frozen=True)
class TextureLibrary:
    """All textures in one flat array, mip level after mip level.

    Attributes:
        texels: (T, 2) uint8 blend and grain.
        offsets: (SIZE_BITS + 1,) int32 start of each mip level in ``texels``.
    """

    texels: NDArray[np.uint8]
    offsets: NDArray[np.int32]

    def sample(
        self,
        texture: NDArray[np.int32],  # (N,) texture numbers
        u: NDArray[np.float32],  # (N,) horizontal coordinate in repeats of the texture
        v: NDArray[np.float32],  # (N,) vertical coordinate in repeats, upwards
        footprint: NDArray[np.float32],  # (N,) texels that one sample sees; chooses the mip level
    ) -> tuple[Image, Image]:
        """(N,) blend in 0..1 and (N,) grain in GRAIN_RANGE at texture coordinates."""
        level = np.clip(np.frexp(footprint)[1] - 1, 0, SIZE_BITS)
        bits = SIZE_BITS - level
        column = (np.floor(u * SIZE).astype(np.int32) & (SIZE - 1)) >> level
        row = (np.floor(v * SIZE).astype(np.int32) & (SIZE - 1)) >> level
        index = self.offsets.take(level) + (((texture << bits) + row) << bits) + column
        both = self.texels.take(index, axis=0).astype(np.float32)
        low, high = GRAIN_RANGE
        return both[:, 0] * np.float32(1 / 255), both[:, 1] * np.float32((high - low) / 255) + low


def build_library(rng: np.random.Generator) -> TextureLibrary:
    """Draw VARIANTS textures of every kind."""
    painters = {
        Kind.PLAIN: _plain,
        Kind.ROUGH: _rough,
        Kind.FACADE: _facade,
        Kind.SHOPFRONT: _shopfront,
        Kind.MASONRY: _masonry,
        Kind.SLATS: _slats,
        Kind.LEAVES: _leaves,
        Kind.SIGN: _sign,
        Kind.DASHES: _dashes,
        Kind.PATCHES: _patches,
        Kind.GLAZING: _glazing,
    }
    full = np.stack([np.stack(painters[k](rng), -1) for k in Kind for _ in range(VARIANTS)])
    low, high = GRAIN_RANGE
    full[..., 1] = (full[..., 1] - low) / (high - low)
    levels: list[NDArray[np.uint8]] = []
    offsets: list[int] = []
    while True:
        offsets.append(sum(map(len, levels)))
        levels.append((full.clip(0, 1) * 255).round().astype(np.uint8).reshape(-1, 2))
        if full.shape[1] == 1:
            return TextureLibrary(np.concatenate(levels), np.array(offsets, np.int32))
        full = (full[:, ::2] + full[:, 1::2]) / 2
        full = (full[:, :, ::2] + full[:, :, 1::2]) / 2


def noise(rng: np.random.Generator, wavelength: float) -> Image:
    """(SIZE, SIZE) tileable noise of unit variance with features of about ``wavelength`` texels."""
    fy, fx = np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None, :]
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE)))
    spectrum *= np.exp(-2 * wavelength**2 * (fx**2 + fy**2))
    spectrum[0, 0] = 0
    field = np.fft.irfft2(spectrum)
    return (field / max(float(field.std()), 1e-9)).astype(np.float32)


def _grain(rng: np.random.Generator, fine: float, coarse: float) -> Image:
    """Grain around 1: fine speckle and coarse stains of the given strengths."""
    return 1 + fine * noise(rng, 1.5) + coarse * noise(rng, 20.0)


def _rectangle(mask: Image, x: float, y: float, width: float, height: float, value: float) -> None:
    """Fill a rectangle given in fractions of the tile; y counts upwards."""
    left, right = round(x * SIZE), round((x + width) * SIZE)
    bottom, top = round(y * SIZE), round((y + height) * SIZE)
    mask[max(bottom, 0) : max(top, 0), max(left, 0) : max(right, 0)] = value


def _plain(rng: np.random.Generator) -> tuple[Image, Image]:
    return np.zeros((SIZE, SIZE), np.float32), _grain(rng, 0.02, rng.uniform(0.02, 0.08))


def _rough(rng: np.random.Generator) -> tuple[Image, Image]:
    stains = np.clip(0.5 * noise(rng, 12.0) - rng.uniform(0.3, 0.8), 0, 1)
    return stains, _grain(rng, rng.uniform(0.08, 0.16), 0.1)


def _facade(rng: np.random.Generator) -> tuple[Image, Image]:
    mask, grain = np.zeros((SIZE, SIZE), np.float32), _grain(rng, 0.04, 0.06)
    width, height = rng.uniform(0.3, 0.8), rng.uniform(0.4, 0.75)
    x, y = (1 - width) / 2, rng.uniform(0.12, 0.9 - height)
    frame = rng.uniform(0.02, 0.05)
    _rectangle(grain, x - frame, y - frame, width + 2 * frame, height + 2 * frame, 1.45)
    _rectangle(grain, x - 0.06, y - 2 * frame, width + 0.12, 1.5 * frame, 1.4)
    _rectangle(mask, x, y, width, height, 1.0)
    _rectangle(grain, x, y, width, height, 1.0)
    _rectangle(grain, x, y + height * 0.5, width, height * 0.5, 1.25)
    for i in range(1, int(rng.integers(1, 4))):
        _rectangle(mask, x + i * width / 3, y, 0.025, height, 0.0)
    if rng.random() < 0.5:
        _rectangle(mask, x, y + rng.uniform(0.4, 0.7) * height, width, 0.025, 0.0)
    if rng.random() < 0.4:
        _rectangle(grain, 0.0, 0.0, 1.0, 0.05, 0.6)
    return mask, grain


def _shopfront(rng: np.random.Generator) -> tuple[Image, Image]:
    mask, grain = np.zeros((SIZE, SIZE), np.float32), _grain(rng, 0.04, 0.05)
    door = rng.uniform(0.2, 0.3)
    split = rng.uniform(0.4, 0.7)
    _rectangle(mask, 0.05, rng.uniform(0.1, 0.3), split - 0.1, rng.uniform(0.35, 0.5), 1.0)
    _rectangle(mask, split, 0.0, door, rng.uniform(0.6, 0.8), rng.uniform(0.5, 1.0))
    _rectangle(grain, 0.0, 0.84, 1.0, rng.uniform(0.06, 0.16), rng.choice([0.55, 1.45]))
    return mask, grain


def _masonry(rng: np.random.Generator) -> tuple[Image, Image]:
    rows, columns = int(rng.choice([8, 16])), int(rng.choice([4, 8]))
    grain = np.zeros((SIZE, SIZE), np.float32)
    mask = np.zeros((SIZE, SIZE), np.float32)
    height, width = SIZE // rows, SIZE // columns
    stones = rng.normal(1.0, rng.uniform(0.05, 0.15), (rows, columns)).astype(np.float32)
    for row in range(rows):
        line = np.repeat(stones[row], width)
        joint = np.zeros(SIZE, np.float32)
        joint[::width] = 0.8
        shift = (row % 2) * (width // 2)
        grain[row * height : (row + 1) * height] = np.roll(line, shift)
        mask[row * height : (row + 1) * height] = np.roll(joint, shift)
        mask[row * height] = 0.8
    return mask, grain * _grain(rng, 0.05, 0.05)


def _slats(rng: np.random.Generator) -> tuple[Image, Image]:
    period = int(rng.choice([8, 16, 32]))
    stripes = (np.arange(SIZE) % period < period * rng.uniform(0.3, 0.7)).astype(np.float32)
    mask = np.broadcast_to(stripes, (SIZE, SIZE))
    if rng.random() < 0.4:
        mask = mask.T
    return np.ascontiguousarray(mask), _grain(rng, 0.05, 0.05)


def _leaves(rng: np.random.Generator) -> tuple[Image, Image]:
    mask = 1 / (1 + np.exp(-3 * (noise(rng, rng.uniform(2, 6)) - rng.uniform(0, 0.8))))
    return mask.astype(np.float32), _grain(rng, 0.18, 0.12)


def _sign(rng: np.random.Generator) -> tuple[Image, Image]:
    mask = np.zeros((SIZE, SIZE), np.float32)
    _rectangle(mask, 0.0, 0.0, 1.0, 1.0, rng.choice([0.0, 1.0]))
    _rectangle(mask, 0.08, 0.08, 0.84, 0.84, 1.0 - mask[0, 0])
    for _ in range(int(rng.integers(2, 7))):
        x, y = rng.uniform(0.1, 0.7, 2)
        width, height = rng.uniform(0.04, 0.3, 2)
        _rectangle(mask, x, y, width, height, float(rng.integers(2)))
    return mask, np.ones((SIZE, SIZE), np.float32)


def _dashes(rng: np.random.Generator) -> tuple[Image, Image]:
    mask = np.zeros((SIZE, SIZE), np.float32)
    mask[:, : int(SIZE * rng.uniform(0.35, 0.6))] = rng.uniform(0.8, 1.0)
    worn = np.clip(noise(rng, 3.0) * 0.3 + 0.9, 0, 1)
    return mask * worn, _grain(rng, 0.08, 0.05)


def _patches(rng: np.random.Generator) -> tuple[Image, Image]:
    mask, grain = np.zeros((SIZE, SIZE), np.float32), _grain(rng, 0.08, 0.06)
    for _ in range(int(rng.integers(2, 6))):
        x, y = rng.uniform(-0.1, 0.8, 2)
        width, height = rng.uniform(0.05, 0.5, 2)
        _rectangle(grain, x, y, width, height, rng.uniform(0.6, 1.4))
    crack = np.abs(noise(rng, 14.0)) < rng.uniform(0.01, 0.05)
    return np.maximum(mask, crack * np.float32(0.8)), grain


def _glazing(rng: np.random.Generator) -> tuple[Image, Image]:
    mask = np.ones((SIZE, SIZE), np.float32)
    post = rng.uniform(0.04, 0.1)
    for x in (0.0, rng.uniform(0.4, 0.6), 1 - post):
        _rectangle(mask, x, 0.0, post, 1.0, 0.0)
    _rectangle(mask, 0.0, 0.0, 1.0, post, 0.0)
    _rectangle(mask, 0.0, 1 - 2 * post, 1.0, 2 * post, 0.0)
    reflections = cv2.GaussianBlur(noise(rng, 10.0), (5, 5), 0)
    return mask, np.clip(1 + 0.2 * reflections, 0.6, 1.5).astype(np.float32)
