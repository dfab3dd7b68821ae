"""Pictures of LiDAR points on the image or on events, one row per extrinsic."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.events.representations import Histogram
from uncal.events.stream import Events, PixelMap

NEAR_M = 4.0
FAR_M = 60.0
TEXT_PX = 18

BRIGHTER_RGB, DARKER_RGB = (0, 114, 178), (213, 94, 0)
"""Blue and vermilion, which the colour-blind tell apart (Okabe and Ito)."""

STRONGEST = 0.6
"""Share of an event's colour in a pixel full of events; more would drown the points."""


def draw_events(events: Events, size: tuple[int, int], pixel_map: PixelMap) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of events, summed over time: blue got brighter, orange darker, white nothing.

    >>> one = np.ones(1, np.float32)
    >>> events = Events(one, 0 * one, np.array([7]), np.array([False]), (0, 10), (1, 2))
    >>> draw_events(events, (1, 2), PixelMap.identity()).tolist()
    [[[255, 255, 255], [230, 158, 102]]]
    """
    darker, brighter = Histogram(normalize=False)(events, size, pixel_map).numpy()
    total = darker + brighter
    # A few pixels of a lamp or a leaf have most of the events.
    full = np.quantile(total[total > 0], 0.9) if len(events) and total.any() else 1.0
    strength = STRONGEST * np.minimum(total / full, 1.0)[..., None]
    share = (brighter / np.maximum(total, 1.0))[..., None]
    colour = share * np.array(BRIGHTER_RGB) + (1.0 - share) * np.array(DARKER_RGB)
    picture = strength * colour + (1.0 - strength) * 255.0
    return np.asarray(picture.round(), dtype=np.uint8)


def draw_points(
    image: NDArray[np.uint8],  # (H, W, 3) RGB
    points: NDArray[np.float32],  # (N, 3 or more) LiDAR frame, metres
    T_cam_lidar: NDArray[np.float64],  # (4, 4) extrinsic to project with
    K: NDArray[np.float64],  # (3, 3) camera matrix of the image
    scale: int,  # enlargement, so that points do not hide what they should line up with
) -> NDArray[np.uint8]:
    """Project points onto an enlarged image, (H·scale, W·scale, 3) RGB; warm colours are near."""
    height, width = image.shape[:2]
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    in_camera = points[:, :3] @ T_cam_lidar[:3, :3].T + T_cam_lidar[:3, 3]
    in_camera = in_camera[in_camera[:, 2] > 0.5]
    # Far points first, so that near ones stay visible.
    in_camera = in_camera[np.argsort(-in_camera[:, 2])]
    pixels = in_camera @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    inside = ((pixels > -0.5) & (pixels < np.array([width, height]) - 0.5)).all(1)
    pixels, depth = pixels[inside], in_camera[inside, 2]
    if not len(pixels):
        return np.asarray(canvas, dtype=np.uint8)
    nearness = np.log(FAR_M / depth.clip(NEAR_M, FAR_M)) / np.log(FAR_M / NEAR_M)
    colours = cv2.applyColorMap(
        (255 * nearness).astype(np.uint8).reshape(-1, 1), cv2.COLORMAP_TURBO
    ).reshape(-1, 3)[:, ::-1]
    centres = np.round((pixels + 0.5) * scale - 0.5).astype(int)
    for (u, v), colour in zip(centres.tolist(), colours.tolist(), strict=True):
        cv2.circle(canvas, (u, v), max(1, scale // 3), colour, -1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def overlay_panel(
    image: NDArray[np.uint8],
    points: NDArray[np.float32],
    K: NDArray[np.float64],
    extrinsics: Mapping[str, NDArray[np.float64]],
    scale: int,
) -> NDArray[np.uint8]:
    """The same sweep under several extrinsics, one above the other: a uint8 RGB picture.

    The arguments are those of :func:`draw_points`, with caption → (4, 4) for the extrinsics.
    """
    rows = []
    for caption, T_cam_lidar in extrinsics.items():
        row = draw_points(image, points, T_cam_lidar, K, scale)
        bar = np.full((TEXT_PX + 8, row.shape[1], 3), 24, np.uint8)
        cv2.putText(
            bar, caption, (6, TEXT_PX), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1,
            cv2.LINE_AA,
        )  # fmt: skip
        rows += [bar, row]
    return np.concatenate(rows)
