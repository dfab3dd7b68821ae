"""The LightningModule around any backbone."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple, cast

import lightning
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from uncal.data.network_input import NetworkInput
from uncal.decalibration import DecalibrationRange
from uncal.errors import RecordingError
from uncal.geometry import DOF_NAMES
from uncal.models.geometric import GeometricSolver, grid_points, true_displacement
from uncal.models.losses import displacement_loss, pose_loss, relative_error
from uncal.uncertainty.conformal import ConformalCalibrator
from uncal.uncertainty.mc_dropout import MCDropout, Prediction


class Estimate(NamedTuple):
    """What a network says of one batch.

    Attributes:
        pose: (B, 6) estimated decalibration, metres and radians.
        flow: (B, 4, h, w) displacement map and log-weights of the geometric head, else None.
    """

    pose: Tensor
    flow: Tensor | None


class SplitPrediction(NamedTuple):
    """Predictions of a split, in the order of its frames, on the CPU.

    Attributes:
        mean: (n, 6) mean of the stochastic passes, metres and radians.
        std: (n, 6) their standard deviation.
        target: (n, 6) the true decalibrations.
    """

    mean: Tensor
    std: Tensor
    target: Tensor


def pass_seed(seed: int, split: str, batch: int) -> int:
    """Seed of the dropout masks of one batch, so that an evaluation can be repeated bit for bit.

    Args:
        seed: the run's.
        split: name of the split.
        batch: number of the batch within it.

    Returns:
        63-bit seed.
    """
    digest = hashlib.sha256(f"{seed}|{split}|{batch}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def join_predictions(parts: list[SplitPrediction], split: str) -> SplitPrediction:
    """Predictions of a split's batches, as one.

    Args:
        parts: one per batch.
        split: its name, for the message.

    Returns:
        All of them.

    Raises:
        RecordingError: there is none.
    """
    if not parts:
        raise RecordingError(
            f"no frame of the {split} split could be read; see the skipped frames listed above"
        )
    return SplitPrediction(*(torch.cat(column) for column in zip(*parts, strict=True)))


class PoseEstimator(nn.Module):
    """A network and, if it returns a displacement map, the least-squares solver behind it.

    Args:
        network: (B, C, H, W) → (B, 6) in units of ``bounds``, or → (B, 4, h, w).
        bounds: (6,) range of the decalibrations, metres and radians.
        ridge: initial ridge of the solver.
    """

    bounds: Tensor

    def __init__(self, network: nn.Module, bounds: Tensor, ridge: float) -> None:
        super().__init__()
        # Channels last is what convolutions on CPUs and tensor cores are fastest with.
        self.network: nn.Module = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.solver = GeometricSolver(bounds, ridge)
        self.register_buffer("bounds", bounds.clone(), persistent=False)

    def encode(self, x: Tensor) -> Tensor:
        """The part of the network that no dropout reaches, if it says so by an ``encode`` method.

        Args:
            x: (B, C, H, W) the network's input.

        Returns:
            What its ``decode`` goes on with; ``x`` itself for a network without the two.
        """
        x = x.contiguous(memory_format=torch.channels_last)
        encode = getattr(self.network, "encode", None)
        return x if encode is None else cast(Tensor, encode(x))

    def decode(
        self, features: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor
    ) -> Estimate:
        """The rest of the network and, where needed, the solver.

        Args:
            features: what :meth:`encode` returned.
            inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection.
            K: (B, 3, 3) camera matrices.
            T_init: (B, 4, 4) decalibrated extrinsics.

        Returns:
            Pose and displacement map.

        Raises:
            ValueError: the network returned neither of the two shapes.
        """
        output = cast(Tensor, getattr(self.network, "decode", self.network)(features))
        if output.shape == (len(features), 6):
            return Estimate(output.float() * self.bounds, None)
        if output.ndim != 4 or output.shape[1] != 4:
            raise ValueError(
                f"the network returned shape {tuple(output.shape)}; expected (B, 6) or (B, 4, h, w)"
            )
        # Pixels and metres need more than half precision.
        with torch.autocast(features.device.type, enabled=False):
            points = grid_points(inverse_depth, K, (output.shape[2], output.shape[3]))
            return Estimate(self.solver(output, points, K, T_init), output)

    def forward(self, x: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
        """The pose alone; see :meth:`decode`."""
        return self.decode(self.encode(x), inverse_depth, K, T_init).pose


class StochasticPart(nn.Module):
    """What differs from pass to pass: an estimator from behind its ``encode`` on.

    The encoder's weights belong to its state too, so that a fingerprint covers the whole.

    Args:
        estimator: the whole.
    """

    def __init__(self, estimator: PoseEstimator) -> None:
        super().__init__()
        self.estimator = estimator

    def forward(self, features: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
        """(B, 6) pose; see :meth:`PoseEstimator.decode`."""
        return self.estimator.decode(features, inverse_depth, K, T_init).pose


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
