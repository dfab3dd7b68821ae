"""From curves to normal equations, against numbers worked out by hand."""

import pytest
import torch
from torch import Tensor

from uncal.edges.evidence import (
    gaussian_factors,
    offsets_of,
    pack,
    profiles,
    project_edges,
    sharp_component,
    unpack,
)
from uncal.edges.sweep import COLUMNS, KIND, KINDS
from uncal.geometry import pose_to_matrix
from uncal.geometry.decalibration import correct

K = torch.tensor([[60.0, 0.0, 30.2], [0.0, 58.0, 19.6], [0.0, 0.0, 1.0]])
T = torch.tensor([[0.0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]])
SIZE = (40, 64)
BOUNDS = torch.tensor([0.1, 0.1, 0.1, 0.02, 0.02, 0.02])


@pytest.mark.parametrize("stride", [1, 2, 4])
@pytest.mark.parametrize("variance", [2.0, 9.0])
@pytest.mark.parametrize(("mean", "spread"), [(0.0, 4.0), (1.3, 2.0), (-2.0, 25.0)])
def test_prior_and_factor_make_the_posterior_of_a_quadratic_curve(
    mean: float, spread: float, variance: float, stride: int
) -> None:
    mean, spread, variance = mean * stride, spread * stride**2, variance * stride**2
    offsets = stride * torch.arange(-40.0, 41.0)
    curve = -0.5 * (offsets - mean) ** 2 / spread
    prior = torch.full((1, 1), variance)
    factor, precision = gaussian_factors(curve[None, None], offsets, prior, stride)
    posterior = 1 / (1 / spread + 1 / variance)
    # Offsets are told no more finely than this, in the prior as in the posterior.
    quantum = 0.08 * stride**2
    together = 1 / (variance + quantum) + precision
    assert together.item() == pytest.approx(1 / (posterior + quantum), rel=1e-3)
    weighted = precision * factor / together
    assert weighted.item() == pytest.approx(posterior * mean / spread, abs=1e-3 * stride)


def test_a_wide_quadratic_curve_gives_its_own_mean_and_variance() -> None:
    offsets = torch.arange(-200.0, 201.0)
    curve = -0.5 * (offsets - 5.0) ** 2 / 100.0
    mean, precision = gaussian_factors(curve[None, None], offsets, torch.full((1, 1), 150.0), 1)
    assert mean.item() == pytest.approx(5.0, rel=0.01)
    assert precision.item() == pytest.approx(0.01, rel=0.01)


def test_a_curve_that_says_nothing_counts_for_nothing() -> None:
    offsets = torch.arange(-30.0, 31.0)
    curve = torch.full((1, 1, 61), -3.0)
    mean, precision = gaussian_factors(curve, offsets, torch.full((1, 1), 4.0), 1)
    assert abs(precision.item()) < 1e-3
    assert mean.item() == pytest.approx(0.0, abs=1e-3)


def test_two_peaks_count_for_less_than_one() -> None:
    offsets = torch.arange(-12.0, 13.0)
    peak = -((offsets - 3.0) ** 2)
    both = torch.logsumexp(torch.stack([peak, -((offsets + 3.0) ** 2)]), 0)
    prior = torch.full((1, 1), 9.0)
    mean, precision = gaussian_factors(both[None, None], offsets, prior, 1)
    _, of_one = gaussian_factors(peak[None, None], offsets, prior, 1)
    assert mean.item() == pytest.approx(0.0, abs=1e-3)
    assert precision.item() < 0.1 * of_one.item()


def test_means_stay_within_two_standard_deviations_of_the_prior() -> None:
    offsets = torch.arange(-12.0, 13.0)
    curve = -5.0 * (offsets - 12.0).abs()
    mean, _ = gaussian_factors(curve[None, None], offsets, torch.full((1, 1), 1.0), 1)
    assert mean.item() == pytest.approx(2.0)


def test_packed_equations_come_back_and_add_up() -> None:
    torch.manual_seed(0)
    root = torch.randn(2, 3, 4, 6, 6)
    normal, right = root @ root.transpose(-1, -2), torch.randn(2, 3, 4, 6)
    packed = pack(normal, right)
    assert packed.shape == (2, 3, 4, 27)
    for found, expected in zip(unpack(packed), (normal, right), strict=True):
        assert torch.equal(found, expected)
    total = unpack(packed.sum(1))
    torch.testing.assert_close(total[0], normal.sum(1))
    torch.testing.assert_close(total[1], right.sum(1))


def ramps(stride: int) -> Tensor:
    """(1, 2, 32/s, 48/s): the column and the row that the middle of each cell has in the image."""
    rows, columns = torch.meshgrid(
        torch.arange(32 // stride) * stride + (stride - 1) / 2,
        torch.arange(48 // stride) * stride + (stride - 1) / 2,
        indexing="ij",
    )
    return torch.stack([columns, rows])[None]


@pytest.mark.parametrize("stride", [1, 2, 4])
def test_profiles_read_the_map_where_the_offsets_lie(stride: int) -> None:
    pixels = torch.tensor([[[20.0, 15.0], [22.25, 16.5], [24.0, 14.0]]])
    along = torch.tensor([[0.0, 0.0, 1.0]])
    read = profiles(ramps(stride), pixels, along, stride, reach=2)
    assert read.shape == (1, 2, 3, 5)
    offsets = offsets_of(stride, 2, read)
    assert offsets.tolist() == [-2 * stride, -stride, 0, stride, 2 * stride]
    for edge, (column, row) in enumerate(pixels[0].tolist()):
        moving = (column, row)[int(along[0, edge])] + offsets
        fixed = torch.full((5,), (row, column)[int(along[0, edge])])
        expected = [moving, fixed] if along[0, edge] == 0 else [fixed, moving]
        torch.testing.assert_close(read[0, :, edge], torch.stack(expected), atol=1e-4, rtol=0.0)


def test_profiles_are_nothing_outside_the_image() -> None:
    maps = torch.ones(1, 1, 32, 48)
    read = profiles(maps, torch.tensor([[[1.0, 10.0]]]), torch.zeros(1, 1), 1, reach=3)
    assert read[0, 0, 0].tolist() == pytest.approx([0, 0, 1, 1, 1, 1, 1], abs=1e-5)


def made_edges(n: int) -> Tensor:
    """(1, n, columns) ahead of the camera, kinds in turn."""
    torch.manual_seed(0)
    edges = torch.rand(1, n, len(COLUMNS))
    aside = (edges[..., 1:3] - 0.5) * torch.tensor([0.8, 0.4])
    depth = 4.0 + 20.0 * edges[..., :1]
    edges[..., :3] = depth * torch.cat([torch.ones_like(depth), aside], -1)
    edges[..., KIND] = torch.arange(n) % len(KINDS)
    return edges


def test_projection_and_its_derivative() -> None:
    edges = made_edges(30)
    projected = project_edges(edges, K[None], T[None], SIZE, BOUNDS)
    assert projected.seen.bool().all()
    assert projected.along[0, :6].tolist() == [0, 0, 0, 1, 1, 1]
    homogeneous = torch.cat([edges[0, :, :3], torch.ones(30, 1)], 1) @ T.T
    pixel = homogeneous[:, :3] @ K.T
    torch.testing.assert_close(projected.pixels[0], pixel[:, :2] / pixel[:, 2:])
    for dof in range(6):
        small = torch.zeros(1, 6)
        small[0, dof] = 0.01
        moved = project_edges(edges, K[None], correct(T[None], small * BOUNDS), SIZE, BOUNDS)
        difference = sharp_component(moved.pixels - projected.pixels, projected.along)
        torch.testing.assert_close(
            difference, 0.01 * projected.jacobian[..., dof], rtol=0.02, atol=2e-4
        )


def test_padding_and_what_the_camera_cannot_see_are_finite_and_uncounted() -> None:
    edges = made_edges(6)
    edges[0, 0] = torch.nan
    edges[0, 1, :3] = torch.tensor([-10.0, 1.0, 0.0])  # behind
    edges[0, 2, :3] = torch.tensor([0.0, 5.0, 0.0])  # beside, in the camera's own plane
    edges[0, 3, :3] = torch.tensor([5.0, 20.0, 0.0])  # ahead, beyond the left border
    projected = project_edges(edges, K[None], T[None], SIZE, BOUNDS)
    assert projected.seen[0].tolist() == [0, 0, 0, 0, 1, 1]
    for each in projected:
        assert each.isfinite().all()
    assert (projected.jacobian[0, :4] == 0).all()


def test_gradients_of_padding_are_finite() -> None:
    edges = made_edges(4)
    edges[0, 2:] = torch.nan
    pose = torch.zeros(1, 6, requires_grad=True)
    projected = project_edges(edges, K[None], T[None] @ pose_to_matrix(pose), SIZE, BOUNDS)
    (projected.pixels.sum() + projected.jacobian.sum()).backward()  # type: ignore[no-untyped-call]
    assert pose.grad is not None
    assert pose.grad.isfinite().all()
