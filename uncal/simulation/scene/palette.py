"""Colours and LiDAR reflectances of surfaces.

What a LiDAR sees at 905 nm goes with visible brightness, but loosely: foliage is dark green and
bright in the near infrared, glass hardly returns anything, number plates and signs shine back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uncal.simulation.scene.meshes import Array, Surfaces
from uncal.simulation.scene.textures import VARIANTS, Kind

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights of linear RGB."""


def colours(
    rng: np.random.Generator,
    n: int,
    value: tuple[float, float],
    saturation: tuple[float, float] = (0.0, 0.5),
    hue: tuple[float, float] = (0.0, 1.0),
) -> Array:
    """Draw n linear RGB albedos from ranges of hue, saturation and value (all in 0..1).

    >>> colours(np.random.default_rng(0), 2, (0.5, 0.5), (0.0, 0.0)).tolist()
    [[0.5, 0.5, 0.5], [0.5, 0.5, 0.5]]
    """
    h = rng.uniform(*hue, n)[:, None]
    s = rng.uniform(*saturation, n)[:, None]
    v = rng.uniform(*value, n)[:, None]
    wheel = np.abs((h * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1
    return np.asarray(v * (1 - s * (1 - wheel.clip(0, 1))), np.float32)


def reflectance(rng: np.random.Generator, rgb: Array) -> Array:
    """LiDAR reflectance that follows (n, 3) albedo with a correlation well below one, (n,)."""
    own = rng.uniform(0.05, 0.6, len(rgb))
    return np.asarray((0.6 * rgb @ LUMINANCE + 0.6 * own).clip(0.02, 0.9), np.float32)


def surfaces(
    rng: np.random.Generator,
    n: int,
    kinds: Kind | tuple[Kind, ...],
    tile_m: ArrayLike,  # metres per repeat; one number, (2,) or (n, 2)
    first: Array,  # (n, 3) albedo where the texture's blend is 0
    second: Array | None = None,  # (n, 3) where it is 1; unset: a darker shade of the first
    reflectances: tuple[float | None, float | None] = (None, None),  # None: drawn from the albedo
    fit: bool = False,  # stretch the tile to whole repeats per face
) -> Surfaces:
    """Surfaces of n objects: a random variant of one of the kinds of texture, two colours."""
    choice = np.atleast_1d(np.asarray(kinds))
    texture = rng.choice(choice, n) * VARIANTS + rng.integers(VARIANTS, size=n)
    if second is None:
        second = first * rng.uniform(0.4, 0.8, (n, 1)).astype(np.float32)
    pair: list[NDArray[np.float32]] = []
    for albedo, fixed in zip((first, second), reflectances, strict=True):
        drawn = reflectance(rng, albedo)
        pair.append(drawn if fixed is None else np.full(n, fixed, np.float32))
    return Surfaces(
        texture=texture.astype(np.int32),
        tile=np.broadcast_to(np.asarray(tile_m, np.float32), (n, 2)),
        colours=np.stack([first, second], 1),
        reflectance=np.stack(pair, 1),
        fit=np.full(n, fit),
    )
