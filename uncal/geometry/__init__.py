"""Rigid transforms, projection, decalibrations and the displacement that they cause."""

from uncal.geometry.transforms import (
    DOF_NAMES,
    DOF_SCALE,
    DOF_UNITS,
    euler_to_matrix,
    invert,
    matrix_to_euler,
    matrix_to_pose,
    pose_to_matrix,
    transform_points,
)

__all__ = [
    "DOF_NAMES",
    "DOF_SCALE",
    "DOF_UNITS",
    "euler_to_matrix",
    "invert",
    "matrix_to_euler",
    "matrix_to_pose",
    "pose_to_matrix",
    "transform_points",
]
