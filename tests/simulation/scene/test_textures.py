from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.scene.textures import (
    SIZE,
    VARIANTS,
    Kind,
    TextureLibrary,
    build_library,
    noise,
)


@pytest.fixture(scope="module")
def library() -> TextureLibrary:
    return build_library(np.random.default_rng(0))


def look_up(
    library: TextureLibrary, texture: int, u: float, v: float, texels: float
) -> tuple[float, float]:
    blend, grain = library.sample(
        np.array([texture], np.int32),
        np.array([u], np.float32),
        np.array([v], np.float32),
        np.array([texels], np.float32),
    )
    return float(blend[0]), float(grain[0])


def test_every_kind_has_its_variants_at_every_level(library: TextureLibrary) -> None:
    textures = len(Kind) * VARIANTS
    sizes = [textures * (SIZE >> level) ** 2 for level in range(8)]
    assert library.offsets.tolist() == [sum(sizes[:level]) for level in range(8)]
    assert len(library.texels) == sum(sizes)


def test_coordinates_wrap_and_rows_go_up(library: TextureLibrary) -> None:
    texture = Kind.MASONRY * VARIANTS + 3
    full = library.texels[: library.offsets[1]].reshape(-1, SIZE, SIZE, 2)[texture]
    row, column = 21, 90
    expected = full[row, column, 0] / 255
    u, v = (column + 0.5) / SIZE, (row + 0.5) / SIZE
    for du, dv in ((0, 0), (1, 0), (-3, 2)):
        assert look_up(library, texture, u + du, v + dv, 1.0)[0] == pytest.approx(expected)


def test_a_large_footprint_sees_the_mean(library: TextureLibrary) -> None:
    texture = Kind.FACADE * VARIANTS
    full = library.texels[: library.offsets[1]].reshape(-1, SIZE, SIZE, 2)[texture]
    blend, grain = look_up(library, texture, 0.3, 0.6, 1000.0)
    assert blend == pytest.approx(full[..., 0].mean() / 255, abs=0.01)
    assert grain == pytest.approx(0.5 + full[..., 1].mean() / 255, abs=0.01)


def test_kinds_look_as_they_should(library: TextureLibrary) -> None:
    full = library.texels[: library.offsets[1]].reshape(len(Kind), VARIANTS, SIZE, SIZE, 2)
    blend = full[..., 0] / 255
    assert (blend[Kind.PLAIN] == 0).all()
    windows = blend[Kind.FACADE].mean((1, 2))
    assert ((windows > 0.05) & (windows < 0.7)).all()
    assert (blend[Kind.FACADE][:, :, 0] == 0).all(), "windows must not touch the tile's edge"
    assert len({full[Kind.SIGN, variant].tobytes() for variant in range(VARIANTS)}) == VARIANTS


def test_noise_is_tileable_and_of_unit_variance() -> None:
    field = noise(np.random.default_rng(0), 8.0)
    assert field.std() == pytest.approx(1.0, rel=1e-4)
    inside = np.abs(np.diff(field, axis=1)).mean()
    assert np.abs(field[:, 0] - field[:, -1]).mean() < 1.5 * inside
