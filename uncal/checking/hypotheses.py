"""What may be wrong with an extrinsic, a camera matrix or a lens, and what each repair would be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uncal.checking.axes import describe, signed_permutations
from uncal.checking.evidence import View, agreement
from uncal.geometry import euler_to_matrix, matrix_to_euler

_SCALES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
_K1 = (-0.4, -0.3, -0.2, -0.12, 0.12, 0.25)
_METRES = 5.0
"""No sensor is further than this from another one on the same vehicle."""

_TURNS = 28
"""Full turns within 180 radians."""

_UPRIGHT = 0.7
"""Cosine between the LiDAR's up and the camera's, at least."""

_KEPT = 24
_ROUGHLY = 2000
_FRAMES = 4
_ROUGH_EDGES = 400


class Hypothesis(NamedTuple):
    """A fault, and the extrinsic, camera matrix and lens as they would be without it.

    Attributes:
        kind: a key of :data:`uncal.checking.finding.KINDS`; empty for what is declared.
        seen: the fault in words.
        remedy: what to do about it.
        T: (4, 4) repaired extrinsic; a reflection where the points or the image are mirrored.
        K: (3, 3) repaired camera matrix at the size of comparison; None: as declared.
        k1: radial distortion that the image still has.
    """

    kind: str
    seen: str
    remedy: str
    T: Tensor
    K: Tensor | None = None
    k1: float = 0.0


def hypotheses(view: View) -> list[Hypothesis]:
    """All that are worth a look in any frame of a drive, likely ones first."""
    T, K, link = view.T, view.K, view.link
    rest = T @ torch.linalg.inv(link)
    width = view.strength.shape[2]
    found = [
        Hypothesis(
            "inverted",
            "the extrinsic fits the data only when inverted",
            "invert it: it must map LiDAR → camera (in DSEC's file, camera → LiDAR)",
            rest @ torch.linalg.inv(link),
        ),
        Hypothesis(
            "camera frame",
            "the points project without any extrinsic: they are in the camera's frame",
            "use the points as the LiDAR gave them, or the identity as T_cam_lidar",
            torch.eye(4),
        ),
        Hypothesis(
            "camera frame",
            "the points are in the frame of the camera that the LiDAR was calibrated to",
            "use the points as the LiDAR gave them",
            rest,
        ),
        Hypothesis(
            "mirrored",
            "the image fits only when its columns are reversed (or the points, handedness)",
            "flip the image back and keep the camera matrix",
            T,
            # fx < 0 reads the image from right to left.
            K * torch.tensor([[-1.0, 1, 1], [1, 1, 1], [1, 1, 1]])
            + torch.tensor([[0, 0, width - 1 - 2 * K[0, 2]], [0, 0, 0], [0, 0, 0]]),
        ),
    ]
    length = float(link[:3, 3].norm())
    for factor, unit in ((1e-3, "millimetres"), (1e-2, "centimetres")):
        if length * factor < _METRES and length > 1.0:
            smaller = link.clone()
            smaller[:3, 3] *= factor
            found.append(
                Hypothesis(
                    "millimetres",
                    f"a translation of {length:.4g} fits the data only as {unit}",
                    f"divide the translation by {1 / factor:.0f}: metres",
                    rest @ smaller,
                )
            )
    scales = {*_SCALES, round(float(width / (2 * K[0, 2].clamp(min=1.0))), 3)}
    for scale in sorted(scales, key=lambda value: abs(np.log(value))):
        if 0.1 < scale < 10 and abs(np.log(scale)) > 0.1:
            scaled = K.clone()
            scaled[:2] *= scale
            found.append(
                Hypothesis(
                    "resolution",
                    f"the camera matrix fits the images only when multiplied by {scale:.3g}",
                    f"multiply fx, fy, cx, cy by {scale:.3g}, or restore the images' size",
                    T,
                    scaled,
                )
            )
    for k1 in _K1:
        found.append(
            Hypothesis(
                "distortion",
                f"the edges fit with a radial distortion of about k1 = {k1:g} left in the image",
                "undistort the images and use the camera matrix of the undistorted ones",
                T,
                k1=k1,
            )
        )
    return found + _axes(T) + _degrees(rest, link)


def _axes(T: Tensor) -> list[Hypothesis]:
    found = []
    for matrix in signed_permutations()[1:]:
        turn = torch.eye(4)
        turn[:3, :3] = torch.from_numpy(matrix)
        handed = "" if np.linalg.det(matrix) > 0 else " (the other handedness)"
        found.append(
            Hypothesis(
                "axes",
                f"the points fit as {describe(matrix)} of what they are{handed}",
                f"give the points as {describe(matrix)}: x forward, y left, z up for T_cam_lidar",
                T @ turn,
            )
        )
        if not handed:
            found.append(
                Hypothesis(
                    "axes",
                    f"the extrinsic leads to a camera whose axes are {describe(matrix)}",
                    "give T_cam_lidar for a camera with x right, y down, z forward",
                    turn @ T,
                )
            )
    return found


def _degrees(rest: Tensor, link: Tensor) -> list[Hypothesis]:
    """Small angles that are radians read as degrees; the other way round needs a search.

    The angles may be those of LiDAR → camera or, as in DSEC's file, of camera → LiDAR.
    """
    found = []
    for inverted in (False, True):
        way = torch.linalg.inv(link) if inverted else link.clone()
        angles = matrix_to_euler(way[:3, :3])
        if float(angles.abs().max().rad2deg()) > 3.2:
            continue
        way[:3, :3] = euler_to_matrix(angles.rad2deg())
        found.append(
            Hypothesis(
                "degrees",
                "the rotation fits only when its angles are multiplied by 180/π",
                "give the angles in the unit that is declared",
                rest @ (torch.linalg.inv(way) if inverted else way),
            )
        )
    return found


def degrees_read_as_radians(views: Sequence[View]) -> list[Hypothesis]:
    """Rotations whose angles, in degrees, were taken for radians.

    An angle of a degrees read as a radians is known modulo 2π: the true one is one of a + 2πk, in
    degrees, a lattice of 6.28° per axis; for the angles of LiDAR → camera and for those of camera →
    LiDAR. Of all its rotations (R = Rz·Ry·Rx) that leave the LiDAR upright in the image, those
    remain whose edges fit best in a few frames: in a single one, others fit by chance.
    """
    view = views[0]
    few = views[:: max(1, len(views) // _FRAMES)][:_FRAMES]
    rough = [one.fewer(max(1, len(one.edges) // _ROUGH_EDGES)) for one in few]
    rest = view.T @ torch.linalg.inv(view.link)
    found = []
    for inverted in (False, True):
        way = torch.linalg.inv(view.link) if inverted else view.link
        R = _lattice(way[:3, :3])
        to_camera = rest[:3, :3] @ (R.transpose(1, 2) if inverted else R)
        R = R[-(to_camera @ view.up)[:, 1] > _UPRIGHT]
        T = way.repeat(len(R), 1, 1)
        T[:, :3, :3] = R
        T = rest @ (torch.linalg.inv(T) if inverted else T)
        # Most of them lie far off in any frame.
        T = T[_values(rough[:1], T).argsort(descending=True)[:_ROUGHLY]]
        best = _values(rough, T).argsort(descending=True)[:_KEPT]
        found += [
            Hypothesis(
                "degrees",
                "the rotation fits only when its angles, read as radians, are taken for degrees",
                "convert the angles to radians before making the rotation",
                T[i],
            )
            for i in best
        ]
    return found


def _values(views: Sequence[View], T: Tensor) -> Tensor:
    """(P,) sum of the agreements of some frames."""
    values = torch.zeros(len(T))
    for chunk, total in zip(torch.split(T, 2048), torch.split(values, 2048), strict=True):
        for view in views:
            total += torch.nan_to_num(agreement(view, chunk), nan=-9.0)
    return values


def _lattice(R: Tensor) -> Tensor:
    """(n, 3, 3) rotations with angles in degrees that, read as radians, give this one."""
    roll, pitch, yaw = matrix_to_euler(R).double().tolist()
    turns = 2 * np.pi * np.arange(-_TURNS, _TURNS + 1)
    rotations = []
    for r, p, y in ((roll, pitch, yaw), (roll + np.pi, np.pi - pitch, yaw + np.pi)):
        axes = [angle + turns for angle in (r, p, y)]
        grid = np.stack(np.meshgrid(*(axis[abs(axis) <= 180] for axis in axes)), -1).reshape(-1, 3)
        rotations.append(euler_to_matrix(torch.from_numpy(np.radians(grid)).float()))
    return torch.cat(rotations)
