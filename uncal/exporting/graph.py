"""One deterministic graph: image, edges, camera matrix and extrinsic to pose and intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.data.network_input import InputSettings, NetworkInput
from uncal.edges.evidence import ProjectedEdges, pack, project_edges
from uncal.edges.sweep import STRENGTH
from uncal.errors import ConfigurationError
from uncal.models.alignment import AlignmentEstimator
from uncal.models.evidence import BLOCK_PX, BLOCKS, STRIDES
from uncal.models.module import CalibrationModule
from uncal.models.operators import Operators
from uncal.models.pose_search import standard_normals
from uncal.uncertainty.dropout.layers import dropout_layers, rate_of
from uncal.uncertainty.dropout.masks import FixedMasks

LONGEST_FOCAL = 1.5
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
    """The whole prediction of one frame, without what depends on the data it meets.

    Args:
        module: an :class:`AlignmentEstimator` with a fitted calibrator.
        inputs: how its images are normalised.
        levels: coverage levels.
        masks: of the stochastic passes; those of the module if its own are fixed.
        operators: those that the graph's runtime has, for a reach of the blur in pixels.

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
        operators: Callable[[int], Operators],
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
        self.operators = operators
        self.widest_blur = 0.0
        if estimator.start is not None:
            self.widest_blur = estimator.start.network.widest_blur
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
        unit, target = torch.zeros(1, dtype=torch.int64), torch.zeros(1, 6)
        batch = NetworkInput(
            x, x[:, :1], K[None], T_init[None], target, unit, [], unit, edges[None]
        )
        estimator, last = self.estimator, self.estimator.last
        widest = self.widest_blur * LONGEST_FOCAL * x.shape[-1]
        operators = self.operators(math.ceil(3.0 * widest))
        maps = last.network.describe(x)
        before_last = len(estimator.rounds) - 1
        state = estimator.begin(batch, operators)
        state = estimator.refine(batch, maps, state, before_last, operators)
        T, size = estimator.assumed(batch, state), (x.shape[-2], x.shape[-1])
        projected = project_edges(batch.edges, batch.K, T, size, last.bounds)
        level = len(STRIDES) - 1
        read = last.network.read(maps, projected, level)
        curves, weights = self.random_curves(read, batch.edges, batch.K, projected)
        around = estimator.around(before_last, state.covariance)
        packed = pack(*last.equations(curves, weights, projected, around, level))
        poses = estimator.solve(packed, state, operators).pose
        mean = packed.mean(0, keepdim=True)
        covariance = estimator.solve(mean, state, operators).covariance[0]
        scales = last.bounds[:, None] * last.bounds
        return self.intervals(poses * last.bounds, covariance * scales)

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
