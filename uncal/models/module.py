"""The LightningModule around any backbone."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from typing import cast

import lightning
import torch
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from uncal.data.network_input import NetworkInput
from uncal.errors import UncertaintyError
from uncal.geometry import DOF_NAMES
from uncal.models.answer import Estimator
from uncal.models.losses import relative_error
from uncal.models.run_state import RunState
from uncal.models.split_prediction import SplitPrediction, frame_seed, join_predictions, pass_names
from uncal.recordings.frame import FrameId
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.ellipsoid import EllipsoidCalibrator
from uncal.uncertainty.conformal.intervals import Intervals
from uncal.uncertainty.dropout.layers import only_active
from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.mc_dropout import MCDropout
from uncal.uncertainty.dropout.pass_memory import PassMemory
from uncal.uncertainty.dropout.prediction import Prediction
from uncal.uncertainty.gather import gather_by_id

log = logging.getLogger(__name__)

NOT_LEARNT = ("calibrator.", "ellipsoid.", "masks.")
"""Parts of the state that no training changes."""


class CalibrationModule(lightning.LightningModule):
    """Owns optimiser and schedule, stochastic passes and calibrator, for any estimator.

    Args:
        estimator: the network and what turns its output into poses.
        optimizer: parameters → optimiser.
        warmup_fraction: part of the training steps in which the learning rate rises.
        engine: network, masks → its MC dropout.
        spread: what σ is made of, one of :data:`uncal.models.split_prediction.SPREADS`.
        fixed_masks: whether all frames meet the same dropout masks in evaluation.
        calibrator: turns means and spreads into intervals.
        groups: what frames of one group share: ``rig`` or ``drive``.
        mask_seed: of the dropout masks in evaluation.
    """

    def __init__(
        self,
        estimator: nn.Module,
        optimizer: Callable[[Iterable[nn.Parameter]], Optimizer],
        warmup_fraction: float,
        engine: Callable[[nn.Module, FixedMasks | None], MCDropout],
        spread: str,
        fixed_masks: bool,
        calibrator: IntervalCalibrator,
        groups: str,
        mask_seed: int,
    ) -> None:
        super().__init__()
        self.estimator = estimator
        self.spread = spread
        self.make_optimizer = optimizer
        self.warmup_fraction = warmup_fraction
        self.masks = FixedMasks(mask_seed) if fixed_masks else None
        self.engine = engine(self._estimator.repeated, self.masks)
        self.engine.keep_samples = True
        self.calibrator = calibrator
        self.ellipsoid = EllipsoidCalibrator()
        self.groups = groups
        self.mask_seed = mask_seed
        self.memory: PassMemory | None = None
        self.recipe: dict[str, object] = {}
        self.run = RunState()
        self._tested: list[SplitPrediction] = []
        self._validation: list[tuple[Tensor, Tensor, Tensor]] = []

    @property
    def learns(self) -> bool:
        """Whether there are parameters to train."""
        return any(parameter.requires_grad for parameter in self.parameters())

    def forward(self, batch: NetworkInput) -> Tensor:
        """(n, 6) estimated decalibrations of a batch, metres and radians."""
        return self._estimator.pose(batch)

    @property
    def _estimator(self) -> Estimator:
        return cast(Estimator, self.estimator)

    def stochastic(self, batch: NetworkInput, split: str) -> SplitPrediction:
        """Mean and spread of the stochastic passes; the same for a frame in any batch."""
        # Whatever mode the module is in: no dropout, and statistics of batches stay as they are.
        with only_active(self.estimator, []):
            question = self._estimator.question(batch)
        samples = self._passes(question.arguments, batch, split)
        answer = self._estimator.answer(samples, batch, question)
        return SplitPrediction.of(answer, batch, self.spread)

    def _passes(self, arguments: tuple[Tensor, ...], batch: NetworkInput, split: str) -> Tensor:
        """(N, B, D) outputs of the network, remembered ones where there are."""
        seeds = [frame_seed(self.mask_seed, split, frame) for frame in batch.frames]
        if self.memory is None:
            return self._kept(self.engine(*arguments, seed=seeds))
        names = pass_names(batch)
        known = self.memory.recall(split, names)
        if known is not None and len(known) == self.engine.passes:
            return known.to(batch.x.device)
        samples = self._kept(
            self.engine(*arguments, seed=seeds)
            if known is None
            else self.engine.extend(known.to(batch.x.device), *arguments, seed=seeds)
        )
        self.memory.remember(split, names, samples)
        return samples

    @staticmethod
    def _kept(prediction: Prediction) -> Tensor:
        assert prediction.samples is not None
        return prediction.samples

    def remember(self, memory: PassMemory) -> None:
        """Keep the passes of the weights as they are now, and use those that are kept already."""
        self.memory = memory

    def fit_calibrator(self, scores: SplitPrediction, frames: Sequence[FrameId]) -> None:
        """Calibrate the intervals of these weights, passes, rates and masks."""
        self.calibrator.fit(
            scores.mean,
            scores.std,
            scores.target,
            groups=scores.groups(frames, self.groups),
            bounds=scores.bounds,
            identity=self.engine.identity(),
        )
        try:
            self.ellipsoid.fit(
                scores.mean, scores.covariance, scores.target, identity=self.engine.identity()
            )
        except UncertaintyError as error:
            log.info("no joint ellipsoid: %s", error)

    def intervals(
        self, predicted: SplitPrediction, frames: Sequence[FrameId], level: float
    ) -> Intervals:
        """Intervals at a level in (0, 1) of predictions of some of the ``frames`` of a split."""
        return self.calibrator.predict(
            predicted.mean,
            predicted.std,
            level,
            groups=predicted.groups(frames, self.groups),
            bounds=predicted.bounds,
        )

    def on_train_start(self) -> None:
        """Follow the schedule from the first step on, also of a resumed training."""
        follow(config.scheduler for config in self.trainer.lr_scheduler_configs)

    def training_step(self, batch: NetworkInput | None, batch_idx: int) -> Tensor | None:
        """One optimisation step; a batch without a readable frame is passed over."""
        if batch is None:
            return None
        loss = self._estimator.loss(batch)
        self.log("loss/train", loss, batch_size=len(batch.x), prog_bar=True)
        return loss

    def validation_step(self, batch: NetworkInput | None, batch_idx: int) -> None:
        """Collect the deterministic estimate; dropout is off."""
        if batch is None:
            return
        pose = self._estimator.pose(batch)
        self._validation.append((batch.unit_index, pose.float(), batch.target))

    def on_validation_epoch_end(self) -> None:
        """Log the error per DoF and its mean, relative to doing nothing."""
        if not self._validation:
            return
        columns = (torch.cat(part) for part in zip(*self._validation, strict=True))
        _, pose, target = gather_by_id(*columns)
        self._validation.clear()
        relative = relative_error(pose, target)
        for name, value in zip(DOF_NAMES, relative, strict=True):
            self.log(f"relative error/{name}", value)
        self.log("relative error/mean", relative.mean(), prog_bar=True)

    def test_step(self, batch: NetworkInput | None, batch_idx: int) -> None:
        """Collect the MC-dropout prediction."""
        if batch is None:
            return
        self._tested.append(self.stochastic(batch, "test"))

    def on_test_epoch_end(self) -> None:
        """Put the predictions together as ``run.tested``."""
        self.run.tested = join_predictions(self._tested, "test")
        self._tested.clear()

    def predict_step(self, batch: NetworkInput | None, batch_idx: int) -> SplitPrediction | None:
        """Mean and σ of the stochastic passes, as in a test; None without a readable frame."""
        return None if batch is None else self.stochastic(batch, "test")

    def on_save_checkpoint(self, checkpoint: dict[str, object]) -> None:
        """Add the settings that another process needs to rebuild this module."""
        checkpoint["uncal_recipe"] = self.recipe
        device = torch.cuda.get_rng_state_all() if torch.cuda.is_available() else []
        checkpoint["uncal_random"] = [torch.get_rng_state(), *device]

    def on_load_checkpoint(self, checkpoint: dict[str, object]) -> None:
        """Go on as if never stopped, with the calibrator and the masks of this run's settings."""
        state = cast("dict[str, Tensor]", checkpoint["state_dict"])
        own = {k: v for k, v in self.state_dict().items() if k.startswith(NOT_LEARNT)}
        learnt = {k: v for k, v in state.items() if not k.startswith(NOT_LEARNT)}
        checkpoint["state_dict"] = {**learnt, **own}
        random = cast("list[Tensor]", checkpoint.get("uncal_random", []))
        # Now, since Lightning draws the next epoch's order before it says that it starts.
        if random:
            torch.set_rng_state(random[0].cpu())
        if len(random) == 1 + torch.cuda.device_count():
            torch.cuda.set_rng_state_all([state.cpu() for state in random[1:]])

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


def follow(schedulers: Iterable[object]) -> None:
    """Give every optimiser the rate that its schedule has for the coming step.

    A checkpoint brings the rate of the schedule that it was made under. In a training resumed with
    another length the first step would still follow that one; with the same length this changes
    nothing, to the last bit. Schedulers that are no :class:`LambdaLR` are left alone.
    """
    for scheduler in schedulers:
        if not isinstance(scheduler, LambdaLR):
            continue
        groups = scheduler.optimizer.param_groups
        parts = zip(groups, scheduler.base_lrs, scheduler.lr_lambdas, strict=True)
        for group, base, factor in parts:
            group["lr"] = base * factor(scheduler.last_epoch)
