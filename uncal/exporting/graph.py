"""One deterministic graph: image, edges, camera matrix and extrinsic to pose and intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.data.network_input import InputSettings, NetworkInput
from uncal.edges.evidence import ProjectedEdges, project_edges
from uncal.edges.sweep import STRENGTH
from uncal.errors import ConfigurationError
from uncal.geometry.decalibration import correct
from uncal.models.alignment import BEYOND, LEAST, PRIOR, AlignmentEstimator
from uncal.models.edge_alignment import Operators
from uncal.models.evidence import BLOCK_PX, BLOCKS, STRIDES
from uncal.models.module import CalibrationModule
from uncal.models.pose_search import standard_normals
from uncal.uncertainty.dropout.layers import dropout_layers, rate_of
from uncal.uncertainty.dropout.masks import FixedMasks

LONGEST_FOCAL = 0.9
"""Focal length, in widths of the image, up to which the start's blur is exact."""

INPUTS: tuple[str, ...] = ("image", "edges", "K", "T_init")
OUTPUTS: tuple[str, ...] = ("mean", "lower", "upper", "joint_lower", "joint_upper")


class GraphOutput(NamedTuple):
    """What the graph answers, in metres and radians.

    Attributes:
        mean: (6,) estimated decalibration.
        lower: (L, 6) lower bounds, one row per level.
        upper: (L, 6) upper bounds.
        joint_lower: (L, 6) lower corner of the box that holds all six at once.
        joint_upper: (L, 6) its upper corner.
    """

    mean: Tensor
    lower: Tensor
    upper: Tensor
    joint_lower: Tensor
    joint_upper: Tensor


class AlignmentGraph(nn.Module):
    """The whole prediction of one frame, of operations that ONNX has.

    Args:
        module: an :class:`AlignmentEstimator` with a fitted calibrator.
        inputs: how its images are normalised.
        levels: coverage levels.
        masks: of the stochastic passes; those of the module if its own are fixed.

    Raises:
        ConfigurationError: another network, or a calibrator whose quantiles are not one number per
            output and level.
    """

    quantiles: Tensor
    joint_quantiles: Tensor
    channel_dropout: Tensor
    evidence_dropout: Tensor

    def __init__(
        self,
        module: CalibrationModule,
        inputs: InputSettings,
        levels: Sequence[float],
        masks: FixedMasks,
    ) -> None:
        super().__init__()
        estimator = module.estimator
        if not isinstance(estimator, AlignmentEstimator) or inputs.camera != "rgb":
            raise ConfigurationError(
                "only networks of model/backbone=edges that read rgb can be exported, such as "
                "weights=unical"
            )
        if module.engine.passes < 2:
            raise ConfigurationError("mcd.passes=1: export needs at least 2 passes")
        self.estimator = estimator
        self.widest_blur = 0.0
        if estimator.start is not None:
            self.widest_blur = float(estimator.start.network.blur.max())
            # Drawn now and kept, so that the graph holds them as numbers.
            search = estimator.start.settings
            standard_normals(sum(estimator.start.network.rounds), search.samples, search.seed)
        self.mean_rgb, self.std_rgb = inputs.rgb_mean, inputs.rgb_std
        self.spread = module.spread
        calibrator = module.calibrator
        # What the hierarchical method asks of a new group is nothing.
        by_group = calibrator.needs_groups and calibrator.kind != "hierarchical"
        if calibrator.needs_bounds or by_group:
            raise ConfigurationError(
                f"interval={calibrator.kind}: its quantiles depend on the group or on the network; "
                "calibrate with interval=conformal, hierarchical or absolute to export"
            )
        self.calibrator = calibrator
        self.sigma_floor = float(calibrator.sigma_floor)
        quantiles = torch.stack([calibrator.quantile(level) for level in levels])
        joint = torch.stack([calibrator.joint_quantile(level) for level in levels])[:, None]
        if len(calibrator.scales):
            joint = joint * calibrator.scales.to(joint)
        if not (quantiles.isfinite().all() and joint.isfinite().all()):
            raise ConfigurationError(
                f"levels={list(levels)}: {len(calibrator.scores)} calibration frames (or, of the "
                "hierarchical method, their drives) are too few for the highest; leave it out, or "
                "calibrate on more"
            )
        self.register_buffer("quantiles", quantiles.float())
        self.register_buffer("joint_quantiles", joint.float())
        passes = module.engine.passes
        active = dropout_layers(estimator.last, module.engine.select)
        rows, columns = BLOCKS
        network = estimator.last.network
        for name, size in (
            ("channel_dropout", network.features + 2),
            ("evidence_dropout", rows * columns),
        ):
            layer = active.get(f"network.{name}")
            p = 0.0 if layer is None else rate_of(layer)
            drawn = masks.of(f"network.{name}", 0, passes, size, p) if p > 0 else None
            self.register_buffer(name, torch.ones(passes, size) if drawn is None else drawn.clone())

    def forward(self, image: Tensor, edges: Tensor, K: Tensor, T_init: Tensor) -> GraphOutput:
        """Predict one frame.

        Args:
            image: (H, W, 3) uint8 RGB at the size of the export.
            edges: (M, columns) float32 of the sweep, :data:`uncal.edges.sweep.COLUMNS`; M ≥ 1.
            K: (3, 3) float32 camera matrix of that image, pixels.
            T_init: (4, 4) float32 assumed extrinsic, LiDAR to camera.

        Returns:
            Pose and intervals, metres and radians.
        """
        x = (image.permute(2, 0, 1)[None].float() / 255.0 - self.mean_rgb) / self.std_rgb
        edges, K, T_init = edges[None], K[None], T_init[None]
        size = (x.shape[-2], x.shape[-1])
        last = self.estimator.last
        maps = last.network.describe(x)
        pose, covariance, precision = self.begin(x, edges, K, T_init)
        before = pose
        before_last = len(self.estimator.rounds) - 1
        for number, level in enumerate(self.estimator.rounds[:-1]):
            T = correct(T_init, pose * last.bounds)
            projected = project_edges(edges, K, T, size, last.bounds)
            read = last.network.read(maps, projected, level)
            curves, weights = last.network.curves(read, edges, K, projected, level)
            around = self.estimator.around(number, covariance)
            normal, right = last.equations(curves, weights, projected, around, level)
            pose, covariance = solve(normal, right, pose, before, precision)
        T = correct(T_init, pose * last.bounds)
        projected = project_edges(edges, K, T, size, last.bounds)
        level = len(STRIDES) - 1
        curves, weights = self.random_curves(
            last.network.read(maps, projected, level), edges, K, projected
        )
        around = self.estimator.around(before_last, covariance)
        normal, right = last.equations(curves, weights, projected, around, level)
        poses, _ = solve(normal, right, pose, before, precision)
        mean = normal.mean(0, keepdim=True), right.mean(0, keepdim=True)
        _, of_solver = solve(*mean, pose, before, precision)
        return self.intervals(
            poses * last.bounds, of_solver[0] * last.bounds[:, None] * last.bounds
        )

    def begin(
        self, x: Tensor, edges: Tensor, K: Tensor, T_init: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """:meth:`AlignmentEstimator.begin` of operations that ONNX has.

        Args:
            x: (1, 3, H, W) normalised image.
            edges: (1, M, columns).
            K: (1, 3, 3).
            T_init: (1, 4, 4).

        Returns:
            Mean (1, 6), covariance and precision (1, 6, 6) before the first round.
        """
        eye = torch.eye(6)[None]
        estimator = self.estimator
        if estimator.start is None:
            return torch.zeros_like(T_init[:, 0, :1]).expand(1, 6), eye / PRIOR, PRIOR * eye
        unit = torch.zeros(1, dtype=torch.int64)
        target = torch.zeros(1, 6)
        batch = NetworkInput(x, x[:, :1], K, T_init, target, unit, [], unit, edges)
        widest = self.widest_blur * LONGEST_FOCAL * x.shape[-1]
        blur = partial(blurred_by_shifts, reach=math.ceil(3.0 * widest))
        state = estimator.start.align(batch, Operators(factor, normal_distribution, blur))
        covariance = estimator.start_inflation * state.covariance + LEAST * eye
        inverse = inverse_factor(covariance)
        return state.pose, covariance, inverse.transpose(1, 2) @ inverse

    def random_curves(
        self, read: Tensor, edges: Tensor, K: Tensor, projected: ProjectedEdges
    ) -> tuple[Tensor, Tensor]:
        """:meth:`EvidenceNetwork.curves` of the finest scale under each pass's masks.

        Args:
            read: (1, F, M, R) features.
            edges: (1, M, columns).
            K: (1, 3, 3).
            projected: the edges.

        Returns:
            Curves (N, M, R) and weights (N, M).
        """
        network = self.estimator.last.network
        level = len(STRIDES) - 1
        query = network.queries[level](network.attributes(edges, K, projected))
        strength = edges[..., STRENGTH].clamp(0.02, 1.0).sqrt() * network.gain[level]
        fixed = torch.stack([1.0 - projected.along, projected.along], -1) * strength[..., None]
        masked = (
            query[0, :, None] * self.channel_dropout
            + F.pad(fixed, (network.features, 0))[0, :, None]
        )
        curves = (masked @ read[0].permute(1, 0, 2)).transpose(0, 1)
        rows, columns = BLOCKS
        cell = (projected.pixels[0] / BLOCK_PX).long()
        index = torch.remainder(cell[:, 1], rows) * columns + torch.remainder(cell[:, 0], columns)
        return curves, projected.seen * torch.index_select(self.evidence_dropout, 1, index)

    def intervals(self, poses: Tensor, of_solver: Tensor) -> GraphOutput:
        """Mean, σ and what the quantiles make of them.

        Args:
            poses: (N, 6) of the passes.
            of_solver: (6, 6) covariance of the solver.
        """
        mean = poses.mean(0)
        variance = ((poses - mean) ** 2).mean(0)
        known = torch.stack([of_solver[i, i] for i in range(6)])
        if self.spread != "dropout":
            variance = known + variance if self.spread == "total" else known
        std = variance.sqrt()
        if self.calibrator.needs_std:
            std = std.clamp(min=self.sigma_floor)
        anchors = self.calibrator._anchors(mean, std, None)
        return GraphOutput(
            mean, *anchors.widened(self.quantiles), *anchors.widened(self.joint_quantiles)
        )


def solve(
    normal: Tensor, right: Tensor, pose: Tensor, before: Tensor, precision: Tensor
) -> tuple[Tensor, Tensor]:
    """:meth:`AlignmentEstimator.solve` without linear-algebra operators, which ONNX lacks.

    Args:
        normal: (N, 6, 6) normal equations of what is left.
        right: (N, 6).
        pose: (1, 6) so far, in units of the range.
        before: (1, 6) mean of the prior.
        precision: (1, 6, 6) of the prior.

    Returns:
        (N, 6) total decalibration, (N, 6, 6) covariance.

    >>> _ = torch.manual_seed(0)
    >>> A, zero = torch.randn(2, 6, 9), torch.zeros(1, 6)
    >>> prior = PRIOR * torch.eye(6)
    >>> _, covariance = solve(A @ A.mT, torch.zeros(2, 6), zero, zero, prior[None])
    >>> torch.allclose(covariance, torch.linalg.inv(A @ A.mT + prior), atol=1e-5)
    True
    """
    inverse = inverse_factor(normal + precision)
    covariance = inverse.transpose(1, 2) @ inverse
    right = right + (precision @ (before - pose)[..., None])[..., 0]
    step = (covariance @ right[..., None])[..., 0]
    return (pose + step).clamp(-BEYOND, BEYOND), covariance


def blurred_by_shifts(maps: Tensor, sigma: Tensor, reach: int) -> Tensor:
    """:func:`uncal.edges.image.blurred` without a kernel that is computed, which ONNX lacks.

    Args:
        maps: (1, C, H, W).
        sigma: (1,) pixels.
        reach: offsets on each side, at least 3 σ.

    >>> from uncal.edges.image import blurred
    >>> maps, sigma = torch.rand(1, 2, 20, 30), torch.tensor([1.7])
    >>> torch.allclose(blurred_by_shifts(maps, sigma, 9), blurred(maps, sigma), atol=1e-6)
    True
    """
    offsets = torch.arange(-reach, reach + 1, dtype=maps.dtype)
    kernel = torch.exp(-0.5 * (offsets / sigma).square()) * (offsets.abs() <= (3.0 * sigma).ceil())
    kernel = kernel / kernel.sum()
    height, width = maps.shape[-2:]
    rows = F.pad(maps, (0, 0, reach, reach), mode="replicate")
    maps = sum(
        (kernel[i] * rows[..., i : i + height, :] for i in range(2 * reach + 1)),
        torch.zeros_like(maps),
    )
    columns = F.pad(maps, (reach, reach, 0, 0), mode="replicate")
    return sum(
        (kernel[i] * columns[..., i : i + width] for i in range(2 * reach + 1)),
        torch.zeros_like(maps),
    )


def normal_distribution(y: Tensor) -> Tensor:
    """Cumulative normal distribution, through the error function."""
    return 0.5 * (1.0 + torch.erf(y / math.sqrt(2.0)))


def factor(matrix: Tensor) -> Tensor:
    """Lower Cholesky factor of (N, 6, 6), unrolled."""
    L = _entries(matrix)
    zero = torch.zeros_like(matrix[:, 0, 0])
    rows = [torch.stack([*row, *[zero] * (5 - i)], -1) for i, row in enumerate(L)]
    return torch.stack(rows, -2)


def _entries(matrix: Tensor) -> list[list[Tensor]]:
    """Rows of L in A = L Lᵀ, entry by entry."""
    L: list[list[Tensor]] = []
    for i in range(6):
        L.append([])
        for j in range(i + 1):
            value = matrix[:, i, j]
            for k in range(j):
                value = value - L[i][k] * L[j][k]
            L[i].append(value.sqrt() if i == j else value / L[j][j])
    return L


def inverse_factor(matrix: Tensor) -> Tensor:
    """L⁻¹ of the Cholesky factorisation A = L Lᵀ, unrolled.

    Args:
        matrix: (N, 6, 6) symmetric positive definite.

    Returns:
        (N, 6, 6) lower triangular.
    """
    L = _entries(matrix)
    X: list[list[Tensor]] = []
    zero = torch.zeros_like(matrix[:, 0, 0])
    for i in range(6):
        row = []
        for j in range(i):
            value = zero
            for k in range(j, i):
                value = value - L[i][k] * X[k][j]
            row.append(value / L[i][i])
        X.append([*row, 1.0 / L[i][i], *[zero] * (5 - i)])
    return torch.stack([torch.stack(row, -1) for row in X], -2)
