"""Leaving out, on the CPU, the LiDAR points that no decalibration can bring into the image.

Five of six points of a full sweep lie beside or behind the image. Which ones may go must not
depend on the decalibration, and the border of the cut must never show in a projected image: an
edge there would be drawn at the true extrinsic and give the answer away.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_BORDER = 1.0
"""Pixels by which the culled frustum exceeds the first and last pixel centres. Half a pixel is the
image's own border; the rest is for projections that round or resize by another convention."""

_ROUNDING = 1e-5
"""Slack for float32 here and in the projection, relative to the range in metres plus one."""

_BLOCK = 16_384
"""Points at a time. Buffers of this size stay in the cache and in the allocator (fresh pages for
a whole sweep cost more than the arithmetic), and BLAS starts no threads, for which workers that
fill the cores would have to wait."""


def frustum_mask(
    points: NDArray[np.float32],
    T_cam_lidar: NDArray[np.float64],
    K: NDArray[np.float64],
    image_size: tuple[int, int],
    max_rotation: float,
    max_translation: float,
) -> NDArray[np.bool_]:
    r"""Mark every point that some decalibration within the bounds brings into the image.

    The assumed extrinsic is T_init = T_cam_lidar · D, D = (R, t) made of six numbers within the
    bounds (:func:`uncal.geometry.pose_to_matrix`). The image is what lies inside four planes
    through the camera centre, and in front of a fifth, z = 0. With unit normal n (camera frame)
    and signed distance d(p) of the LiDAR point p under the true extrinsic, D changes d by

        n · R_cam_lidar · ((R - I) p + t)  ≤  κ ‖p‖ + t_max ‖R_cam_lidarᵀ n‖₁,

    so p is kept if no plane has d < -(κ ‖p‖ + t_max ‖R_cam_lidarᵀ n‖₁). κ = ‖R - I‖ at the
    largest rotation; see :func:`largest_rotation_chord`.

    Args:
        points: (N, 3), metres, LiDAR frame; a view of the first three columns of (N, 4) will do.
        T_cam_lidar: (4, 4) true extrinsic, LiDAR → camera.
        K: (3, 3) camera matrix without skew, pixels.
        image_size: height and width of the image that K belongs to.
        max_rotation: bound of |roll|, |pitch| and |yaw|, radians.
        max_translation: bound of |x|, |y| and |z|, metres.

    Returns:
        (N,) True for the points to keep; never False for a point that can become visible.

    Raises:
        ValueError: a bound is negative or not finite.

    >>> K = np.array([[50.0, 0.0, 49.5], [0.0, 50.0, 24.5], [0.0, 0.0, 1.0]])
    >>> T_cam_lidar = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    >>> ahead, just_beside, behind = [10.0, 0, 0], [10.0, 10.5, 0], [-10.0, 0, 0]
    >>> points = np.array([ahead, just_beside, behind], dtype=np.float32)
    >>> frustum_mask(points, T_cam_lidar, K, (50, 100), 0.0, 0.0).tolist()
    [True, False, False]
    >>> frustum_mask(points, T_cam_lidar, K, (50, 100), math.radians(5), 0.1).tolist()
    [True, True, False]
    """
    if not (0 <= max_translation < math.inf):
        raise ValueError(f"max_translation is {max_translation}, expected metres, at least 0.")
    chord = largest_rotation_chord(max_rotation) + _ROUNDING
    normals = _frustum_normals(K, image_size)
    directions = normals @ T_cam_lidar[:3, :3]
    reach = max_translation * np.abs(directions).sum(axis=1)
    offsets = normals @ T_cam_lidar[:3, 3] + reach + _ROUNDING

    directions32, offsets32 = directions.astype(np.float32), offsets.astype(np.float32)[:, None]
    keep = np.empty(len(points), dtype=np.bool_)
    for start in range(0, len(points), _BLOCK):
        block = slice(start, start + _BLOCK)
        # Coordinates as rows: every step then runs along contiguous memory.
        coordinates = np.ascontiguousarray(points[block].T, dtype=np.float32)
        distances = directions32 @ coordinates
        distances += offsets32
        ranges = np.sqrt(np.square(coordinates).sum(axis=0))
        np.greater_equal(distances.min(axis=0), ranges * np.float32(-chord), out=keep[block])
    return keep


def largest_rotation_chord(max_rotation: float) -> float:
    """How far a rotation by three bounded Euler angles can move a unit vector.

    R = Rz(yaw) · Ry(pitch) · Rx(roll) turns by θ with, in half angles,

        cos(θ/2) = cos r · cos p · cos y + sin r · sin p · sin y.

    Where this is positive it is concave in each half angle, so that its smallest value over
    |r|, |p|, |y| ≤ a = max_rotation / 2 is at a corner: cos³a - sin³a (positive for a < 45°). A
    unit vector moves by at most the chord 2 sin(θ/2); about √3 · max_rotation for small angles.

    Returns:
        max ‖(R - I) u‖ over unit vectors u and rotations with three angles up to ``max_rotation``,
        radians; 2 from 90° on.

    Raises:
        ValueError: the bound is negative or not finite.

    >>> round(largest_rotation_chord(0.01), 5)
    0.01735
    """
    if not (0 <= max_rotation < math.inf):
        raise ValueError(f"max_rotation is {max_rotation}, expected radians, at least 0.")
    if max_rotation >= math.pi / 2:
        return 2.0
    cosine = math.cos(max_rotation / 2) ** 3 - math.sin(max_rotation / 2) ** 3
    return 2.0 * math.sqrt(1.0 - cosine**2)


def _frustum_normals(K: NDArray[np.float64], image_size: tuple[int, int]) -> NDArray[np.float64]:
    """(5, 3) unit normals in the camera frame, pointing inwards: left, right, top, bottom, z = 0.

    A point is right of column u if fx·x + (cx - u)·z ≥ 0, and so on.
    """
    height, width = image_size
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    normals = np.array(
        [
            [fx, 0.0, cx + _BORDER],
            [-fx, 0.0, width - 1 + _BORDER - cx],
            [0.0, fy, cy + _BORDER],
            [0.0, -fy, height - 1 + _BORDER - cy],
            [0.0, 0.0, 1.0],
        ]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals
