"""ROS files say what the extrinsic and its covariance are."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.geometry.transforms import euler_to_matrix, matrix_to_pose, pose_to_matrix
from uncal.recordings.static_transform import StaticTransform

AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def extrinsic(turn_deg: tuple[float, float, float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = AHEAD @ Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    T[:3, 3] = 0.06, -0.07, -0.27
    return T


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (1.0, -2.0, 3.0), (0.0, 0.0, 0.4)])
def test_both_files_give_the_extrinsic_back(
    tmp_path: Path, turn: tuple[float, float, float]
) -> None:
    T = extrinsic(turn)
    written = StaticTransform(T, np.diag([1e-4] * 3 + [1e-6] * 3), "tried").write(tmp_path / "rig")
    assert [path.name for path in written] == ["rig.transform.yaml", "rig.urdf"]
    said = yaml.safe_load(written[0].read_text())
    assert (said["header"]["frame_id"], said["child_frame_id"]) == ("camera_optical_frame", "lidar")
    rotation = Rotation.from_quat([said["transform"]["rotation"][axis] for axis in "xyzw"])
    np.testing.assert_allclose(rotation.as_matrix(), T[:3, :3], atol=1e-9)
    translation = [said["transform"]["translation"][axis] for axis in "xyz"]
    np.testing.assert_allclose(translation, T[:3, 3], atol=1e-9)
    assert len(said["covariance"]) == 36
    joint = ElementTree.fromstring(written[1].read_text()).find("joint")
    assert joint is not None
    origin = joint.find("origin")
    assert origin is not None
    rpy = torch.tensor([float(v) for v in origin.attrib["rpy"].split()], dtype=torch.float64)
    np.testing.assert_allclose(euler_to_matrix(rpy).numpy(), T[:3, :3], atol=1e-8)


def test_covariance_is_that_of_perturbed_extrinsics() -> None:
    T = extrinsic((2.0, -1.0, 4.0))
    A = np.random.default_rng(0).normal(size=(6, 6)) * ([0.01] * 3 + [0.002] * 3)
    covariance = A.T @ A
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance, 40_000)
    moved = T @ pose_to_matrix(torch.from_numpy(draws)).numpy()
    left = moved @ np.linalg.inv(T)
    # About the parent's axes, through the LiDAR's origin.
    turned = matrix_to_pose(torch.from_numpy(left)).numpy()[:, 3:]
    shifted = moved[:, :3, 3] - T[:3, 3]
    found = np.cov(np.hstack([shifted, turned]).T)
    known = StaticTransform(T, covariance, "").covariance_in_parent
    scale = np.sqrt(np.outer(np.diag(known), np.diag(known)))
    np.testing.assert_allclose(found / scale, known / scale, atol=0.03)
