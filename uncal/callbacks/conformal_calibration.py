"""Conformal intervals for any LightningModule that predicts numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import cast

import lightning
import torch
from lightning import LightningModule, Trainer
from torch import Tensor, nn

from uncal.errors import ConfigurationError, UncertaintyError
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Intervals
from uncal.uncertainty.conformal.split_conformal import AbsoluteCalibrator, ConformalCalibrator
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity
from uncal.uncertainty.dropout.mc_dropout import MCDropout


class ConformalCalibration(lightning.Callback):
    """Calibrates the intervals of a module that is not ours when its training ends.

    The calibration frames must be exchangeable with those of use, and neither training nor model
    selection may have seen them. What ``forward`` returns decides the score: a tensor (B, D) is
    scored by |ŷ - y|, a pair (mean, σ) or a distribution with ``mean`` and ``stddev`` by
    |ŷ - y| / σ. With ``passes`` the module's dropout layers give the σ. The state is in the
    trainer's checkpoints.

    Args:
        dataloader: batches of the uncertainty calibration set.
        target: where the target is in a batch: an index or a key; the input is then what ``input``
            names.
        input: where the input is.
        forward: name of the module's method that takes the input; ``predict_step`` is given the
            whole batch and its number instead.
        passes: stochastic passes of MC dropout; None: the module is asked once.
        seed: of the passes.

    Raises:
        ConfigurationError: ``passes`` with ``predict_step``.
    """

    def __init__(
        self,
        dataloader: Iterable[object],
        target: int | str = 1,
        input: int | str = 0,
        forward: str = "forward",
        passes: int | None = None,
        seed: int = 0,
    ) -> None:
        if passes is not None and forward == "predict_step":
            raise ConfigurationError(
                "passes needs a method that takes the input alone, such as forward='forward'"
            )
        self.dataloader = dataloader
        self.target, self.input = target, input
        self.forward = forward
        self.passes, self.seed = passes, seed
        self.calibrator: IntervalCalibrator | None = None

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Calibrate the weights that training ended with."""
        self.calibrate(pl_module)

    def calibrate(self, module: LightningModule) -> IntervalCalibrator:
        """Fit on the calibration dataloader; to be called again after other weights are loaded.

        Raises:
            UncertaintyError: no batch, or predictions that do not fit the targets.
        """
        rows = []
        for number, batch in enumerate(self.dataloader):
            mean, std = self._predict(module, batch, number)
            target = _part(batch, self.target, "target").to(mean)
            target = target.reshape(mean.shape) if target.numel() == mean.numel() else target
            rows.append((mean, torch.ones_like(mean) if std is None else std, target.cpu()))
        if not rows:
            raise UncertaintyError("ConformalCalibration: the calibration dataloader is empty")
        calibrator = AbsoluteCalibrator() if std is None else ConformalCalibrator()
        means, stds, targets = (torch.cat(parts) for parts in zip(*rows, strict=True))
        self.calibrator = calibrator.fit(means, stds, targets, identity=self._identity(module))
        return self.calibrator

    def predict(self, module: LightningModule, batch: object, level: float | Fraction) -> Intervals:
        """(B, D) intervals of new data.

        Args:
            module: the one that was calibrated.
            batch: of the same form as the calibration's; its target is not read.
            level: coverage level in (0, 1).

        Raises:
            UncertaintyError: not calibrated, or the module has other weights since.
        """
        if self.calibrator is None:
            raise UncertaintyError(
                "ConformalCalibration: not calibrated; train with the callback or call calibrate"
            )
        self.calibrator.check_matches(self._identity(module))
        mean, std = self._predict(module, batch, 0)
        return self.calibrator.predict(mean, torch.ones_like(mean) if std is None else std, level)

    def state_dict(self) -> dict[str, object]:
        """What the trainer's checkpoint keeps."""
        if self.calibrator is None:
            return {}
        return {"kind": self.calibrator.kind, "state": self.calibrator.state_dict()}

    def load_state_dict(self, state_dict: dict[str, object]) -> None:
        """Take up the calibration of a checkpoint."""
        if not state_dict:
            return
        kind = ConformalCalibrator if state_dict["kind"] == "conformal" else AbsoluteCalibrator
        self.calibrator = kind()
        self.calibrator.load_state_dict(cast("dict[str, Tensor]", state_dict["state"]))

    def _identity(self, module: nn.Module) -> PredictorIdentity:
        return PredictorIdentity.of(module, self.passes or 1)

    def _predict(
        self, module: LightningModule, batch: object, number: int
    ) -> tuple[Tensor, Tensor | None]:
        """(B, D) mean and, where there is one, σ, on the CPU; in evaluation mode."""
        batch = module.transfer_batch_to_device(batch, module.device, 0)
        training = module.training
        module.eval()
        try:
            with torch.no_grad():
                if self.forward == "predict_step":
                    return _mean_and_std(module.predict_step(batch, number))
                given = _part(batch, self.input, "input")
                method = getattr(module, self.forward)
                if self.passes is None:
                    return _mean_and_std(method(given))
                network = module if self.forward == "forward" else _Named(module, self.forward)
                found = MCDropout(network, self.passes)(given, seed=self.seed + number)
                return _columns(found.mean), _columns(found.std)
        finally:
            module.train(training)


class _Named(nn.Module):
    """A method of a module as a module."""

    def __init__(self, module: nn.Module, name: str) -> None:
        super().__init__()
        self.module, self.name = module, name

    def forward(self, x: Tensor) -> object:
        return getattr(self.module, self.name)(x)


def _part(batch: object, key: int | str, what: str) -> Tensor:
    try:
        value = batch[key]  # type: ignore[index]
    except (KeyError, IndexError, TypeError) as error:
        held = list(batch) if isinstance(batch, Mapping) else type(batch).__name__
        raise ConfigurationError(
            f"ConformalCalibration: {what}={key!r} is not in the batch ({held}); name its index "
            "or key"
        ) from error
    return cast(Tensor, value)


def _mean_and_std(output: object) -> tuple[Tensor, Tensor | None]:
    if isinstance(output, Tensor):
        return _columns(output), None
    if isinstance(output, tuple) and len(output) == 2:
        return _columns(output[0]), _columns(output[1])
    if hasattr(output, "mean") and hasattr(output, "stddev"):
        return _columns(output.mean), _columns(output.stddev)
    raise UncertaintyError(
        f"ConformalCalibration: the module returned {type(output).__name__}; expected a tensor, "
        "a pair (mean, σ) or a distribution with mean and stddev"
    )


def _columns(values: Tensor) -> Tensor:
    return (values[:, None] if values.ndim == 1 else values.flatten(1)).cpu()
