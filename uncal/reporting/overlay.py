"""Pictures of LiDAR points on the image, one row per extrinsic."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

NEAR_M = 4.0
FAR_M = 60.0
TEXT_PX = 18


def draw_points(
    image: NDArray[np.uint8],
    points: NDArray[np.float32],
    T_cam_lidar: NDArray[np.float64],
    K: NDArray[np.float64],
    scale: int,
) -> NDArray[np.uint8]:
    """Project points onto an enlarged image; warm colours are near.

    Args:
        image: (H, W, 3) uint8 RGB.
        points: (N, 3 or more) LiDAR frame, metres.
        T_cam_lidar: (4, 4) extrinsic to project with.
        K: (3, 3) camera matrix of the image.
        scale: enlargement, so that points do not hide what they should line up with.

    Returns:
        (H·scale, W·scale, 3) uint8 RGB.
    """
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
    """The same sweep under several extrinsics, one above the other, each with its caption.

    Args:
        image: (H, W, 3) uint8 RGB.
        points: (N, 3 or more) LiDAR frame, metres.
        K: (3, 3) camera matrix.
        extrinsics: caption → (4, 4).
        scale: enlargement.

    Returns:
        uint8 RGB picture.
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
