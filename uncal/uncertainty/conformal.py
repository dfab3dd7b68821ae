"""Split conformal calibration of MC-dropout intervals, per degree of freedom (eqs. 3-5)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch
from torch import Tensor

from uncal.uncertainty.errors import NotCalibratedError, UncertaintyError
from uncal.uncertainty.fingerprint import PredictorIdentity
from uncal.uncertainty.quantile import (
    conformal_quantile,
    conformal_rank,
    miscoverage,
    samples_needed,
    warn_too_few,
)
from uncal.uncertainty.state import CalibratorState

__all__ = [
    "ConformalCalibrator",
    "Intervals",
    "conformal_quantile",
    "conformal_rank",
    "miscoverage",
    "samples_needed",
]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Intervals:
    """Prediction intervals in the units of the network (eq. 5).

    Attributes:
        mean: (..., D) centres ŷ.
        std: (..., D) σ as used, after the floor.
        lower: (..., D) ŷ - Q σ.
        upper: (..., D) ŷ + Q σ.
        level: the coverage level 1-α that they promise per output.
    """

    mean: Tensor
    std: Tensor
    lower: Tensor
    upper: Tensor
    level: float


class ConformalCalibrator(CalibratorState):
    """Turns (ŷ, σ) into intervals that hold each output with probability at least 1-α.

    s = |ŷ - y| / max(σ, floor), Q = s_(⌈(m+1)(1-α)⌉), [ŷ - Q σ, ŷ + Q σ]   (paper, eqs. 3-5)

    The guarantee is per output, over the draw of the uncertainty calibration set and of a frame
    exchangeable with its frames. All that the fit learned is in buffers: the calibrator travels in
    the checkpoint of the module that holds it, loads into a fresh instance, and answers any level.
    Buffers move with ``.to(device)`` but keep their number type.

    Args:
        names: the outputs' names in messages, such as :data:`uncal.geometry.DOF_NAMES`; None
            numbers them.
        sigma_floor: smallest σ to divide by, in the network's own units. It is a constant, not
            a fraction of the σ seen, since a floor learned from the scores' own frames would cost
            the guarantee. 0 is the paper's equation, where σ = 0 is refused. A loaded state brings
            its own floor.

    Raises:
        ConfigurationError: a negative or non-finite floor.

    >>> target = torch.arange(1.0, 101.0)[:, None]
    >>> calibrator = ConformalCalibrator()
    >>> _ = calibrator.fit(torch.zeros(100, 1), torch.ones(100, 1), target)
    >>> intervals = calibrator.predict(torch.zeros(1), 2 * torch.ones(1), level=0.9)
    >>> intervals.lower.item(), intervals.upper.item()
    (-182.0, 182.0)
    """

    def __init__(self, names: Sequence[str] | None = None, sigma_floor: float = 0.0) -> None:
        """Make an unfitted calibrator."""
        super().__init__(sigma_floor)
        self.names = None if names is None else tuple(names)
        self._warned: set[Fraction] = set()

    def fit(
        self,
        mean: Tensor,
        std: Tensor,
        target: Tensor,
        *,
        identity: PredictorIdentity | None = None,
    ) -> ConformalCalibrator:
        """Keep the sorted scores of the uncertainty calibration set; replaces an earlier fit.

        Args:
            mean: (m, D) ŷ of frames that neither training nor model selection has seen.
            std: (m, D) σ.
            target: (m, D) the truth.
            identity: the predictor, ``MCDropout.identity()``, to be checked before later use.

        Returns:
            Itself.

        Raises:
            UncertaintyError: wrong shapes, values that are not finite, σ negative, or σ = 0.
        """
        if mean.ndim != 2 or len(mean) == 0 or not mean.shape == std.shape == target.shape:
            raise UncertaintyError(
                f"mean {tuple(mean.shape)}, std {tuple(std.shape)}, target {tuple(target.shape)}: "
                "all three must be (m, D) with m ≥ 1 samples of the uncertainty calibration set."
            )
        if self.names is not None and mean.shape[1] != len(self.names):
            raise UncertaintyError(
                f"{mean.shape[1]} outputs for {len(self.names)} names ({', '.join(self.names)}): "
                "give one name per output, in the network's order."
            )
        for label, values in (("mean", mean), ("std", std), ("target", target)):
            self._check_finite(label, values)
        silent = (std == 0).all(0)
        if silent.any():
            raise UncertaintyError(
                f"σ = 0 in all {len(std)} samples of {self._name_list(silent)}: dropout does not "
                "reach them. Check that MC dropout is on (mcd.passes, dropout rates p > 0)."
            )
        # Buffers made in inference mode (Lightning's validation loop) could not be loaded into.
        with torch.inference_mode(False), torch.no_grad():
            mean, std, target = (_at_least_float32(t.clone()) for t in (mean, std, target))
            used = self._floored(std)
            self._keep((mean - target).abs() / used, identity)
        if n_floored := int((used > std).sum()):
            _log.info("σ raised to the floor in %d of %d values", n_floored, std.numel())
        self._warned.clear()
        return self

    def quantile(self, level: float) -> Tensor:
        """(D,) Q(1-α) per output; +inf, with a warning once per fit and level, if m is too small.

        Raises:
            NotCalibratedError: before :meth:`fit` or a load.
            UncertaintyError: a level outside (0, 1).
        """
        if not self.is_fitted:
            raise NotCalibratedError(
                "The calibrator holds no scores: call fit(mean, std, target) on the uncertainty "
                "calibration set, or load the state of a fitted one, before asking for intervals."
            )
        try:
            alpha = miscoverage(level)
        except ValueError as error:
            raise UncertaintyError(str(error)) from None
        m = len(self.scores)
        rank = conformal_rank(m, alpha)
        if rank > m:
            if alpha not in self._warned:
                self._warned.add(alpha)
                warn_too_few(m, alpha, stacklevel=3)
            return torch.full_like(self.scores[0], torch.inf)
        return self.scores[rank - 1].clone()

    def predict(self, mean: Tensor, std: Tensor, level: float) -> Intervals:
        """Intervals of new predictions (eq. 5).

        Args:
            mean: (..., D) ŷ.
            std: (..., D) σ.
            level: coverage level 1-α in (0, 1), any.

        Raises:
            NotCalibratedError: before :meth:`fit` or a load.
            UncertaintyError: wrong shapes, values that are not finite, σ = 0 without a floor, or
                a level outside (0, 1).
        """
        quantile = self.quantile(level)
        if mean.shape != std.shape or mean.ndim == 0 or mean.shape[-1] != len(quantile):
            raise UncertaintyError(
                f"mean {tuple(mean.shape)} and std {tuple(std.shape)}: both must be "
                f"(..., {len(quantile)}), the outputs that the calibrator was fitted on."
            )
        self._check_finite("mean", mean)
        self._check_finite("std", std)
        mean, std = _at_least_float32(mean), self._floored(_at_least_float32(std))
        half = quantile.to(std) * std
        return Intervals(mean, std, mean - half, mean + half, level)

    def _floored(self, std: Tensor) -> Tensor:
        """Max(σ, floor), refusing σ that is negative, or 0 where there is no floor."""
        floor = float(self.sigma_floor)
        bad = std <= 0 if floor == 0 else std < 0
        if bad.any():
            raise UncertaintyError(
                f"{int(bad.sum())} of {bad.numel()} σ are not positive "
                f"({self._name_counts(bad)}), the smallest {float(std.min()):g}: a score divides "
                "by σ. Check that MC dropout is on, or set a small positive sigma_floor."
            )
        return std.clamp_min(floor)

    def _check_finite(self, label: str, values: Tensor) -> None:
        bad = ~values.isfinite()
        if bad.any():
            raise UncertaintyError(
                f"{int(bad.sum())} of {bad.numel()} values of {label} are NaN or infinite "
                f"({self._name_counts(bad)}): expected finite numbers. Leave those frames out, or "
                "find where the network diverges."
            )

    def _name_counts(self, mask: Tensor) -> str:
        """Such as "X: 3, Yaw: 1", for the marked entries of a (..., D) mask."""
        per_output = mask.reshape(-1, mask.shape[-1]).sum(0).tolist()
        names = self._output_names(len(per_output))
        return ", ".join(f"{a}: {n}" for a, n in zip(names, per_output, strict=True) if n)

    def _name_list(self, mask: Tensor) -> str:
        names = self._output_names(len(mask))
        return ", ".join(a for a, marked in zip(names, mask.tolist(), strict=True) if marked)

    def _output_names(self, size: int) -> tuple[str, ...]:
        if self.names is not None and len(self.names) == size:
            return self.names
        return tuple(f"output {j}" for j in range(size))

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Tensor], prefix: str, *args: object
    ) -> None:
        """Other scores may be too few again: let them warn anew."""
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._warned.clear()


def _at_least_float32(values: Tensor) -> Tensor:
    return values.to(torch.promote_types(values.dtype, torch.float32))
