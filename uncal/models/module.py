"""The LightningModule around any backbone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import lightning
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from uncal.data.network_input import NetworkInput
from uncal.decalibration import DecalibrationRange
from uncal.geometry import DOF_NAMES
from uncal.models.estimator import PoseEstimator, StochasticPart
from uncal.models.geometric import grid_points, true_displacement
from uncal.models.losses import displacement_loss, pose_loss, relative_error
from uncal.models.prediction import SplitPrediction, join_predictions, pass_seed
from uncal.uncertainty.conformal import ConformalCalibrator
from uncal.uncertainty.mc_dropout import MCDropout, Prediction


class CalibrationModule(lightning.LightningModule):
    """Owns loss, optimiser and schedule, for any network that :class:`PoseEstimator` accepts.

    Args:
        network: the backbone with its head.
        decalibration: the range of the decalibrations, which scales outputs and loss.
        optimizer: parameters → optimiser.
        warmup_fraction: part of the training steps in which the learning rate rises.
        displacement_weight: weight of the displacement loss (per pixel) beside the pose loss.
        ridge: initial ridge of the geometric head's solver.
        passes: stochastic passes of a prediction.
        chunk: most rows of one replicated batch, or None.
        sigma_floor: of the conformal calibrator, metres and radians.
        seed: of the dropout masks in evaluation.
    """

    def __init__(
        self,
        network: nn.Module,
        decalibration: DecalibrationRange,
        optimizer: Callable[[Iterable[nn.Parameter]], Optimizer],
        warmup_fraction: float,
        displacement_weight: float,
        ridge: float,
        passes: int,
        chunk: int | None,
        sigma_floor: float,
        seed: int,
    ) -> None:
        super().__init__()
        self.estimator = PoseEstimator(network, decalibration.bounds, ridge)
        self.make_optimizer = optimizer
        self.warmup_fraction = warmup_fraction
        self.displacement_weight = displacement_weight
        self.engine = MCDropout(StochasticPart(self.estimator), passes, chunk)
        self.calibrator = ConformalCalibrator(DOF_NAMES, sigma_floor)
        self.seed = seed
        self.recipe: dict[str, object] = {}
        self.tested: SplitPrediction | None = None
        self._tested: list[SplitPrediction] = []
        self._validation: list[tuple[Tensor, Tensor]] = []

    def forward(self, batch: NetworkInput) -> Tensor:
        """Estimate the decalibration of a batch.

        Args:
            batch: B network inputs.

        Returns:
            (B, 6) metres and radians.
        """
        pose: Tensor = self.estimator(*batch[:4])
        return pose

    def loss(self, batch: NetworkInput) -> tuple[Tensor, Tensor]:
        """Pose loss plus, for a displacement map, the loss of the map itself.

        Args:
            batch: B network inputs.

        Returns:
            The loss (scalar) and the estimated pose (B, 6).
        """
        estimate = self.estimator.decode(self.estimator.encode(batch.x), *batch[1:4])
        loss = pose_loss(estimate.pose, batch.target, self.estimator.bounds)
        if estimate.flow is not None:
            flow = estimate.flow.float()
            points = grid_points(batch.inverse_depth, batch.K, (flow.shape[2], flow.shape[3]))
            truth = true_displacement(points.points_cam, batch.K, batch.T_init, batch.target)
            displacement = flow[:, :2].flatten(2).transpose(1, 2)
            error = displacement_loss(displacement, truth, points.seen)
            loss = loss + self.displacement_weight * error
        return loss, estimate.pose

    def stochastic(self, batch: NetworkInput, seed: int) -> Prediction:
        """Mean and spread of the stochastic passes; what no dropout reaches runs once.

        Args:
            batch: B network inputs.
            seed: of the dropout masks.

        Returns:
            Mean and σ, each (B, 6), metres and radians.
        """
        training = self.estimator.training
        self.estimator.eval()
        try:
            with torch.inference_mode():
                features = self.estimator.encode(batch.x)
            return self.engine(features, *batch[1:4], seed=seed)
        finally:
            self.estimator.train(training)

    def training_step(self, batch: NetworkInput | None, batch_idx: int) -> Tensor | None:
        """One optimisation step; a batch without a readable frame is passed over."""
        if batch is None:
            return None
        loss, _ = self.loss(batch)
        self.log("loss/train", loss, batch_size=len(batch.x), prog_bar=True)
        return loss

    def validation_step(self, batch: NetworkInput | None, batch_idx: int) -> None:
        """Collect the deterministic estimate; dropout is off."""
        if batch is None:
            return
        loss, pose = self.loss(batch)
        self.log("loss/validation", loss, batch_size=len(batch.x), on_epoch=True)
        self._validation.append((pose.float(), batch.target))

    def on_validation_epoch_end(self) -> None:
        """Log the error per DoF and its mean, relative to doing nothing."""
        if not self._validation:
            return
        pose, target = (torch.cat(part) for part in zip(*self._validation, strict=True))
        self._validation.clear()
        relative = relative_error(pose, target)
        for name, value in zip(DOF_NAMES, relative, strict=True):
            self.log(f"relative error/{name}", value)
        self.log("relative error/mean", relative.mean(), prog_bar=True)

    def test_step(self, batch: NetworkInput | None, batch_idx: int) -> None:
        """Collect the MC-dropout prediction."""
        if batch is None:
            return
        prediction = self.stochastic(batch, pass_seed(self.seed, "test", batch_idx))
        self._tested.append(
            SplitPrediction(prediction.mean.cpu(), prediction.std.cpu(), batch.target.cpu())
        )

    def on_test_epoch_end(self) -> None:
        """Put the predictions together as ``tested``."""
        self.tested = join_predictions(self._tested, "test")
        self._tested.clear()

    def on_save_checkpoint(self, checkpoint: dict[str, object]) -> None:
        """Add the settings that another process needs to rebuild this module."""
        checkpoint["uncal_recipe"] = self.recipe

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        """The configured optimiser under a linear warm-up and a cosine decay over all steps."""
        optimizer = self.make_optimizer(self.parameters())
        total = max(1, int(self.trainer.estimated_stepping_batches))
        warmup = max(1, round(self.warmup_fraction * total))

        def factor(step: int) -> float:
            if step < warmup:
                return (step + 1) / warmup
            return 0.5 * (
                1.0 + math.cos(math.pi * min(1.0, (step - warmup) / (total - warmup + 1)))
            )

        scheduler = LambdaLR(optimizer, factor)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }
