"""An extrinsic for ROS: static transform (YAML) and fixed joint (URDF), with its covariance.

Parent is the camera's optical frame (x right, y down, z forward), child the LiDAR, so that the
transform is T_cam_lidar itself: it maps points of the LiDAR to the camera, and its translation is
where the LiDAR lies in the camera's frame. The covariance is that of a
``geometry_msgs/PoseWithCovariance``: x, y, z, then rotations about axes through the LiDAR's origin
that are parallel to the parent's x, y, z; row by row, m², m·rad and rad².
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class StaticTransform:
    """An extrinsic with the covariance of its error.

    Attributes:
        T_cam_lidar: (4, 4) LiDAR to camera.
        covariance: (6, 6) of a decalibration in the LiDAR frame, in the order of
            :data:`uncal.geometry.DOF_NAMES`, metres and radians.
        about: what the covariance is of, and where it comes from, for people.
        parent: name of the camera's optical frame.
        child: name of the LiDAR's frame.
    """

    T_cam_lidar: Matrix
    covariance: Matrix
    about: str
    parent: str = "camera_optical_frame"
    child: str = "lidar"

    @property
    def covariance_in_parent(self) -> Matrix:
        """(6, 6) as ROS orders and orients it.

        To first order a decalibration (t, ω) of the LiDAR frame moves the LiDAR's origin by R t in
        the camera's frame and turns it by R ω about the camera's axes.

        >>> R = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # LiDAR x is the camera's z
        >>> T = np.block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
        >>> known = StaticTransform(T, np.diag([9.0, 1, 4, 0, 0, 1]), "")
        >>> np.diag(known.covariance_in_parent).tolist()
        [1.0, 4.0, 9.0, 0.0, 1.0, 0.0]
        """
        turn = np.kron(np.eye(2), self.T_cam_lidar[:3, :3])
        return np.asarray(turn @ self.covariance @ turn.T)

    def write(self, stem: Path) -> list[Path]:
        """Write ``stem.transform.yaml`` and ``stem.urdf``; ``stem`` is a path without a suffix."""
        yaml_file = stem.with_name(f"{stem.name}.transform.yaml")
        urdf_file = stem.with_name(f"{stem.name}.urdf")
        stem.parent.mkdir(parents=True, exist_ok=True)
        yaml_file.write_text(self.as_yaml(), encoding="utf-8")
        urdf_file.write_text(self.as_urdf(), encoding="utf-8")
        return [yaml_file, urdf_file]

    def as_yaml(self) -> str:
        """``geometry_msgs/TransformStamped`` with a covariance beside it."""
        t = self.T_cam_lidar[:3, 3]
        q = Rotation.from_matrix(self.T_cam_lidar[:3, :3]).as_quat()
        content = {
            "header": {"frame_id": self.parent},
            "child_frame_id": self.child,
            "transform": {
                "translation": _named("xyz", t),
                "rotation": _named("xyzw", q),
            },
            "covariance": [float(f"{v:.9g}") for v in self.covariance_in_parent.ravel()],
        }
        head = (
            f"# {self.about}\n"
            "# Maps points of the child (LiDAR: x forward, y left, z up) to the parent (camera's\n"
            "# optical frame: x right, y down, z forward); metres.\n"
            "# covariance: 6 × 6 by rows; x, y, z, then rotation about the parent's x, y, z.\n"
        )
        text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
        return head + text

    def as_urdf(self) -> str:
        """A robot of two links and a fixed joint; rpy is about fixed axes, x first."""
        t = self.T_cam_lidar[:3, 3]
        rpy = _fixed_angles(self.T_cam_lidar[:3, :3])
        origin = f'xyz="{_numbers(t)}" rpy="{_numbers(rpy)}"'
        covariance = "\n    ".join(_numbers(row) for row in self.covariance_in_parent)
        return (
            '<?xml version="1.0"?>\n'
            '<robot name="extrinsic">\n'
            f'  <link name="{self.parent}"/>\n'
            f'  <link name="{self.child}"/>\n'
            f'  <joint name="{self.parent}_to_{self.child}" type="fixed">\n'
            f'    <parent link="{self.parent}"/>\n'
            f'    <child link="{self.child}"/>\n'
            f"    <origin {origin}/>\n"
            "  </joint>\n"
            f"  <!-- {self.about.replace('--', '—')}\n"
            "    Covariance (URDF has no place for it): x, y, z, rotation about x, y, z of the "
            "parent.\n"
            f"    {covariance} -->\n"
            "</robot>\n"
        )


def _fixed_angles(R: Matrix) -> Matrix:
    """Roll, pitch, yaw of R = Rz·Ry·Rx, also at a pitch of ±90°, where yaw is taken as 0.

    A LiDAR that looks where the camera looks is such a case.
    """
    pitch = float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _named(names: str, values: Matrix) -> dict[str, float]:
    return {name: float(f"{value:.12g}") for name, value in zip(names, values, strict=True)}


def _numbers(values: Matrix) -> str:
    return " ".join(f"{value:.12g}" for value in values)
