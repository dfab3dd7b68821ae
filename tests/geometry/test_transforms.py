import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.geometry import (
    euler_to_matrix,
    invert,
    matrix_to_pose,
    pose_to_matrix,
    transform_points,
)


def random_poses(n: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    scale = torch.tensor([5.0, 5.0, 5.0, 3.0, 1.5, 3.0], dtype=torch.float64)
    unit = 2 * torch.rand(n, 6, generator=generator, dtype=torch.float64) - 1
    return unit * scale


def test_euler_angles_agree_with_scipy() -> None:
    poses = random_poses(200)
    expected = Rotation.from_euler("xyz", poses[:, 3:].numpy()).as_matrix()
    np.testing.assert_allclose(euler_to_matrix(poses[:, 3:]).numpy(), expected, atol=1e-12)


def test_pose_survives_the_round_trip() -> None:
    poses = random_poses(200)
    torch.testing.assert_close(matrix_to_pose(pose_to_matrix(poses)), poses)


def test_inverse_undoes() -> None:
    transform = pose_to_matrix(random_poses(50))
    identity = torch.eye(4, dtype=torch.float64).expand(50, 4, 4)
    torch.testing.assert_close(transform @ invert(transform), identity)


@pytest.mark.parametrize(
    ("dof", "point", "moved"),
    [
        (3, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),  # roll lifts the left side
        (4, [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),  # pitch lowers the nose
        (5, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),  # yaw turns the nose to the left
    ],
)
def test_a_quarter_turn_about_each_axis(dof: int, point: list[float], moved: list[float]) -> None:
    pose = torch.zeros(6)
    pose[dof] = torch.pi / 2
    result = transform_points(pose_to_matrix(pose), torch.tensor([point]))
    torch.testing.assert_close(result, torch.tensor([moved]), atol=1e-6, rtol=0.0)
