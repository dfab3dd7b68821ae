import torch
from torch import Tensor

from uncal.geometry import invert, pose_to_matrix, transform_points
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.geometry.projection import (
    displacement_jacobian,
    pixel_coordinates,
    project,
    true_displacement,
)
from uncal.models.estimator import (
    GeometricSolver,
    GridPoints,
    PointGeometry,
    grid_points,
)

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
CAMERA_FROM_LIDAR = torch.tensor(
    [[0.02, -1, 0.01, 0.05], [0.0, -0.01, -1, -0.08], [1, 0.02, 0, -0.27], [0, 0, 0, 1]]
)
K = torch.tensor([[230.0, 0.0, 103.2], [0.0, 228.0, 41.7], [0.0, 0.0, 1.0]])
GRID = (20, 52)


def scene(batch: int) -> tuple[Tensor, Tensor, Tensor]:
    """Inverse depth of a wall-and-floor-like cloud, K, decalibrated extrinsics and the truth."""
    torch.manual_seed(0)
    spread = (2 * torch.rand(20000, 2) - 1) * torch.tensor([0.5, 0.2])
    direction = torch.cat([torch.ones(20000, 1), spread], -1)
    xyz = direction * torch.empty(20000, 1).uniform_(4.0, 40.0)
    points = torch.cat([xyz, torch.ones(20000, 1)], -1).expand(batch, -1, -1)
    target = RANGE.draw(batch)
    rotation = torch.linalg.qr(CAMERA_FROM_LIDAR[:3, :3]).Q
    T = CAMERA_FROM_LIDAR.clone()
    T[:3, :3] = rotation * torch.sign((rotation * CAMERA_FROM_LIDAR[:3, :3]).sum(0))
    T_init = decalibrate(T.expand(batch, 4, 4), target)
    seen = project(points, T_init, K.expand(batch, 3, 3), (80, 208))
    return seen.inverse_depth, T_init, target


def perfect_map(points: GridPoints, camera: Tensor, T_init: Tensor, target: Tensor) -> Tensor:
    """(B, 4, h, w) the true displacement, every cell equally trusted."""
    truth = true_displacement(points.points_cam, camera, T_init, target)
    displacement = truth.transpose(1, 2).reshape(-1, 2, *GRID)
    return torch.cat([displacement, torch.zeros_like(displacement)], 1)


def test_grid_points_lie_where_the_depth_image_says() -> None:
    inverse_depth = torch.zeros(1, 1, 80, 208)
    inverse_depth[0, 0, 9, 17] = 0.1
    inverse_depth[0, 0, 10, 18] = 0.2  # the nearest of its 4 × 4 cell
    points = grid_points(inverse_depth, K[None], GRID)
    assert points.seen.sum() == 1
    cell = int(points.seen[0].argmax())
    assert cell == 2 * GRID[1] + 4
    expected = torch.tensor([(18 - 103.2) / 230 * 5, (10 - 41.7) / 228 * 5, 5.0])
    torch.testing.assert_close(points.points_cam[0, cell], expected)


def test_the_jacobian_is_the_derivative_of_the_projection() -> None:
    T_init = CAMERA_FROM_LIDAR.double()[None]
    T_init[:, :3, :3] = torch.linalg.qr(T_init[:, :3, :3]).Q
    camera = K.double()[None]
    points = torch.tensor([[[1.0, 0.5, 8.0], [-3.0, 1.0, 20.0]]], dtype=torch.float64)
    in_lidar = transform_points(invert(T_init), points)

    def pixels(pose: Tensor) -> Tensor:
        moved = T_init @ invert(pose_to_matrix(pose[None]))
        return pixel_coordinates(transform_points(moved, in_lidar), camera)

    numeric = torch.func.jacrev(pixels)(torch.zeros(6, dtype=torch.float64))
    analytic = displacement_jacobian(points, camera, T_init)
    torch.testing.assert_close(analytic, numeric, rtol=1e-6, atol=1e-6)


def test_true_displacement_leads_to_the_true_projection() -> None:
    inverse_depth, T_init, target = scene(2)
    camera = K.expand(2, 3, 3)
    points = grid_points(inverse_depth, camera, GRID)
    moved = true_displacement(points.points_cam, camera, T_init, target)
    T_true = T_init @ invert(pose_to_matrix(target))
    in_lidar = transform_points(invert(T_init), points.points_cam)
    expected = pixel_coordinates(transform_points(T_true, in_lidar), camera)
    start = pixel_coordinates(points.points_cam, camera)
    seen = points.seen.bool()
    torch.testing.assert_close((start + moved)[seen], expected[seen], atol=1e-2, rtol=1e-4)


def test_a_perfect_map_gives_the_decalibration() -> None:
    inverse_depth, T_init, target = scene(8)
    camera = K.expand(8, 3, 3)
    points = grid_points(inverse_depth, camera, GRID)
    flow = perfect_map(points, camera, T_init, target)
    geometry = PointGeometry(RANGE.bounds)(inverse_depth, camera, T_init, GRID)
    pose = GeometricSolver(RANGE.bounds, ridge=1e-6)(flow, geometry)
    # What is left is the second order of a 1° rotation.
    assert ((pose - target).abs().mean(0) / target.abs().mean(0)).max() < 0.05


def test_low_confidence_takes_cells_out() -> None:
    inverse_depth, T_init, target = scene(4)
    camera = K.expand(4, 3, 3)
    points = grid_points(inverse_depth, camera, GRID)
    flow = perfect_map(points, camera, T_init, target)
    flow[:, :2, :, ::3] += 25.0
    geometry = PointGeometry(RANGE.bounds)(inverse_depth, camera, T_init, GRID)
    solver = GeometricSolver(RANGE.bounds, ridge=1e-6)
    misled = (solver(flow, geometry) - target).abs().mean()
    flow[:, 2:, :, ::3] = -8.0
    flow[:, 2:, :, 1::3] = flow[:, 2:, :, 2::3] = 4.0
    trusted = (solver(flow, geometry) - target).abs().mean()
    assert trusted < 0.05 * misled


def test_without_points_the_prior_answers() -> None:
    inverse_depth, T_init, _ = scene(1)
    nothing = torch.zeros_like(inverse_depth)
    geometry = PointGeometry(RANGE.bounds)(nothing, K[None], T_init, GRID)
    pose = GeometricSolver(RANGE.bounds, 0.1)(torch.ones(1, 4, *GRID), geometry)
    assert torch.equal(pose, torch.zeros(1, 6))
