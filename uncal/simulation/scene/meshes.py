"""Triangles of simple solids, many at once, with texture coordinates and surface properties."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Points = NDArray[np.float64]

_CORNERS = np.array(
    [[x, y, z] for z in (0, 1) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
)
_SIDES = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
_ENDS = np.array([[4, 5, 6, 7], [3, 2, 1, 0]])
_UNIT_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@dataclass(frozen=True)
class Surfaces:
    """Surface properties of n objects.

    Attributes:
        texture: (n,) numbers of textures in the library.
        tile: (n, 2) metres per repeat of the texture, horizontally and vertically.
        colours: (n, 2, 3) linear RGB albedo where the texture's blend is 0 and where it is 1.
        reflectance: (n, 2) what the LiDAR sees at its wavelength, likewise.
        fit: (n,) whether the tile is stretched so that whole repeats fill a face (windows).
    """

    texture: NDArray[np.int32]
    tile: Array
    colours: Array
    reflectance: Array
    fit: NDArray[np.bool_]

    def __getitem__(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Surfaces:
        """The surfaces of some of the objects, repeated where the index repeats."""
        return Surfaces(**{name: values[index] for name, values in vars(self).items()})

    def where(self, first: NDArray[np.bool_], second: Surfaces) -> Surfaces:
        """These surfaces where ``first`` is true, those of ``second`` elsewhere."""
        chosen = {}
        for name, values in vars(self).items():
            mask = first.reshape(-1, *[1] * (values.ndim - 1))
            chosen[name] = np.where(mask, values, getattr(second, name))
        return Surfaces(**chosen)


@dataclass
class Mesh:
    """Triangles collected from many objects; one entry per call of :meth:`add`."""

    triangles: list[Array] = field(default_factory=list)
    uv: list[Array] = field(default_factory=list)
    texture: list[NDArray[np.int32]] = field(default_factory=list)
    colours: list[Array] = field(default_factory=list)
    reflectance: list[Array] = field(default_factory=list)
    texel_density: list[Array] = field(default_factory=list)

    def add(
        self,
        quads: Points,
        extent: Points,
        surfaces: Surfaces,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Add quads, each split into two triangles.

        Args:
            quads: (n, q, 4, 3) corners in metres: lower left, lower right, upper right, upper left
                as seen from outside.
            extent: (n, q, 2) width and height of each quad in metres, for the texture.
            surfaces: of the n objects.
            rng: shifts each object's texture, so that repeats don't line up along the street;
                without it, every quad starts at the texture's corner.
        """
        if not len(quads):
            return
        repeats = extent / surfaces.tile[:, None]
        whole = np.maximum(np.round(repeats), 1)
        repeats = np.where(surfaces.fit[:, None, None], whole, repeats)
        uv = _UNIT_UV * repeats[:, :, None]
        if rng is not None:
            shift = np.where(surfaces.fit[:, None], 0.0, rng.random((len(quads), 2)))
            uv = uv + shift[:, None, None]
        corners = [0, 1, 2, 0, 2, 3]
        self.add_triangles(
            quads[:, :, corners].reshape(len(quads), -1, 3, 3),
            uv[:, :, corners].reshape(len(quads), -1, 3, 2),
            surfaces,
        )

    def add_boxes(
        self,
        base: Points,
        size: Points,
        yaw: Points,
        sides: Surfaces,
        rng: np.random.Generator,
        ends: Surfaces | None = None,
        taper: Points | float = 1.0,
    ) -> None:
        """Add boxes; see :func:`boxes`. ``ends``: surfaces of top and bottom, unset: the sides'."""
        side_quads, side_extent, end_quads, end_extent = boxes(base, size, yaw, taper)
        self.add(side_quads, side_extent, sides, rng)
        self.add(end_quads, end_extent, ends or sides, rng)

    def add_triangles(self, triangles: Points, uv: Points, surfaces: Surfaces) -> None:
        """Add (n, t, 3, 3) triangles of n objects with (n, t, 3, 2) texture coordinates."""
        if not triangles.size:
            return
        each = triangles.shape[1]
        self.triangles.append(triangles.reshape(-1, 3, 3).astype(np.float32))
        self.uv.append(uv.reshape(-1, 3, 2).astype(np.float32))
        self.texture.append(np.repeat(surfaces.texture, each).astype(np.int32))
        self.colours.append(np.repeat(surfaces.colours, each, axis=0).astype(np.float32))
        self.reflectance.append(np.repeat(surfaces.reflectance, each, axis=0).astype(np.float32))
        self.texel_density.append(np.repeat(1 / surfaces.tile.min(1), each).astype(np.float32))


def rotate(points: Points, yaw: Points) -> Points:
    """Rotate (n, ..., 3) points of n objects about z by (n,) radians."""
    shape = (-1,) + (1,) * (points.ndim - 2)
    c, s = np.cos(yaw).reshape(shape), np.sin(yaw).reshape(shape)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, points[..., 2]], -1)


def boxes(
    base: Points,  # (n, 3) centre of the lower face, metres
    size: Points,  # (n, 3) length, width, height, metres
    yaw: Points,  # (n,) rotation about z, radians
    taper: Points | float = 1.0,  # (n, 2) length and width of the upper face by the lower's
) -> tuple[Points, Points, Points, Points]:
    """Corners of boxes standing on their base.

    Returns:
        Sides (n, 4, 4, 3) with extents (n, 4, 2); top and bottom (n, 2, 4, 3) with extents.
    """
    corners = _CORNERS[None] * size[:, None]
    corners[:, 4:, :2] *= np.broadcast_to(taper, (len(base), 2))[:, None]
    corners = rotate(corners, yaw) + base[:, None]
    length, width, height = size.T
    along = np.stack([length, width, length, width], 1)
    side_extent = np.stack([along, np.broadcast_to(height[:, None], along.shape)], -1)
    end_extent = np.repeat(size[:, None, :2], 2, axis=1)
    return corners[:, _SIDES], side_extent, corners[:, _ENDS], end_extent


def prisms(
    base: Points,  # (n, 3) centre of the lower end, metres
    radius: Points,  # (n,) metres
    height: Points,  # (n,) metres
    top: Points,  # (n, 2) x, y of the upper end relative to the lower, metres
    sides: int,
) -> tuple[Points, Points]:
    """Side faces of upright prisms: poles and trunks.

    Returns:
        Quads (n, sides, 4, 3) and extents (n, sides, 2).
    """
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    lower = base[:, None] + radius[:, None, None] * ring
    upper = lower + np.concatenate([top, height[:, None]], 1)[:, None]
    quads = np.stack([lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]], 2)
    width = radius * (2 * np.pi / sides)
    extent = np.stack([width, height], -1)[:, None].repeat(sides, axis=1)
    return quads, extent


def _icosphere() -> tuple[Points, NDArray[np.int64]]:
    """Vertices (42, 3) and faces (80, 3) of an icosahedron split once."""
    g = (1 + 5**0.5) / 2
    vertices = [(-1.0, g, 0.0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    vertices += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4)]
    faces += [(11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8)]
    faces += [(3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    points = [np.array(v) / np.linalg.norm(v) for v in vertices]
    middles: dict[tuple[int, int], int] = {}

    def middle(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in middles:
            point = points[i] + points[j]
            points.append(point / np.linalg.norm(point))
            middles[key] = len(points) - 1
        return middles[key]

    split = []
    for i, j, k in faces:
        ij, jk, ki = middle(i, j), middle(j, k), middle(k, i)
        split += [(i, ij, ki), (j, jk, ij), (k, ki, jk), (ij, jk, ki)]
    return np.array(points), np.array(split)


_SPHERE_POINTS, _SPHERE_FACES = _icosphere()


def blobs(
    centre: Points,  # (n, 3) metres
    radii: Points,  # (n, 3) metres
    roughness: float,  # relative standard deviation of the vertices' distance from the centre
    rng: np.random.Generator,
) -> tuple[Points, Points]:
    """Dented low-poly ellipsoids: crowns, bushes, heads.

    Returns:
        Triangles (n, 80, 3, 3) and texture coordinates (n, 80, 3, 2) in metres.
    """
    dent = 1 + roughness * rng.standard_normal((len(centre), len(_SPHERE_POINTS), 1))
    points = centre[:, None] + radii[:, None] * _SPHERE_POINTS * dent.clip(0.5, 1.5)
    triangles = points[:, _SPHERE_FACES]
    across = triangles[..., 0] + triangles[..., 1]
    up = triangles[..., 2] + 0.3 * (triangles[..., 0] - triangles[..., 1])
    return triangles, np.stack([across, up], -1)
