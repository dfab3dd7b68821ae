"""The interface that all interval methods share: fit once, then ask for any level."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, ClassVar, Literal

import torch
from torch import Tensor

from uncal.errors import ConfigurationError, NotCalibratedError, UncertaintyError
from uncal.uncertainty.conformal.fitted_state import CalibratorState
from uncal.uncertainty.conformal.intervals import Anchors, InputChecks, Intervals, at_least_float32
from uncal.uncertainty.conformal.quantile import conformal_rank, miscoverage, warn_too_few
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity

if TYPE_CHECKING:
    from typing_extensions import Self

_log = logging.getLogger(__name__)


class IntervalCalibrator(CalibratorState):
    """Turns predictions into intervals; a method says what is widened, and by which quantile.

    A method widens :class:`Anchors` by a quantile q of the scores of the uncertainty calibration
    set: s_j per output, and max_j s_j / scale_j for a box that holds all outputs at once. Here q
    is the ⌈(m+1)(1-α)⌉-th smallest of all m scores (eq. 4); other rules override :meth:`_pick`.

    All that the fit learned is in buffers: the calibrator travels in the checkpoint of the module
    that holds it, loads into a fresh instance, and answers any level. Buffers move with
    ``.to(device)`` but keep their number type.

    Args:
        names: the outputs' names in messages, such as :data:`uncal.geometry.DOF_NAMES`; None
            numbers them.
        sigma_floor: smallest σ to divide by, in the network's own units. It is a constant, not
            a fraction of the σ seen, since a floor learned from the scores' own frames would cost
            the guarantee. 0 is the paper's equation, where σ = 0 is refused. A loaded state brings
            its own floor.
        scales: (D,) what one unit of each output's score counts in the joint score; None for
            ones. Constants for the same reason, and a loaded state brings its own too.

    Raises:
        ConfigurationError: a negative or non-finite floor, or scales that are not positive.
    """

    guaranteed: ClassVar[bool] = True
    """Finite-sample coverage for frames exchangeable with those of the fit."""
    needs_std: ClassVar[bool] = True
    """Divides by σ, so that MC dropout must give one."""
    needs_bounds: ClassVar[bool] = False
    """Needs the network's own quantile outputs."""
    needs_groups: ClassVar[bool] = False
    """Needs to know which frames belong together."""

    def __init__(
        self,
        names: Sequence[str] | None = None,
        sigma_floor: float = 0.0,
        scales: Sequence[float] | None = None,
    ) -> None:
        super().__init__(sigma_floor, scales)
        self._check = InputChecks(names, type(self).__name__)

    @property
    def names(self) -> tuple[str, ...] | None:
        """The outputs' names in messages."""
        return self._check.names

    def fit(
        self,
        mean: Tensor,
        std: Tensor,
        target: Tensor,
        *,
        groups: Sequence[str] | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
        identity: PredictorIdentity | None = None,
    ) -> Self:
        """Keep the sorted scores of the uncertainty calibration set; replaces an earlier fit.

        Args:
            mean: (m, D) ŷ of frames that neither training nor model selection has seen.
            std: (m, D) σ.
            target: (m, D) the truth.
            groups: m labels, such as the drive or rig of each frame, where the method needs them.
            bounds: (m, D) lower and upper quantile outputs, where the method needs them.
            identity: the predictor, ``MCDropout.identity()``, to be checked before later use.

        Raises:
            UncertaintyError: wrong shapes, values that are not finite, groups or bounds that the
                method needs missing, or, where it divides by σ, σ negative or 0.
        """
        self._check.sizes(mean, std, target, len(self.scales))
        for label, values in (("mean", mean), ("std", std), ("target", target)):
            self._check.finite(label, values)
        if self.needs_std:
            self._check.spread(std)
        labels = self._check.groups(groups, len(mean)) if self.needs_groups else ()
        # Buffers made in inference mode (Lightning's validation loop) could not be loaded into.
        with torch.inference_mode(False), torch.no_grad():
            mean, std, target = (at_least_float32(t.clone()) for t in (mean, std, target))
            used = self._used_std(std)
            if bounds is not None:
                bounds = (bounds[0].clone(), bounds[1].clone())
            self._learn(self._anchors(mean, used, bounds).scores(target), labels)
            self._record(len(mean), identity, mean.device)
        if n_floored := int((used > std).sum()):
            _log.info("σ raised to the floor in %d of %d values", n_floored, std.numel())
        return self

    def quantile(self, level: float | Fraction, *, groups: Sequence[str] | None = None) -> Tensor:
        """(D,) q per output; (n, D) by group; +inf, with one warning, from too few samples.

        Args:
            level: coverage level 1-α in (0, 1); a float counts as the decimal it prints as.
            groups: n labels, where the quantile depends on them.

        Raises:
            NotCalibratedError: before :meth:`fit` or a load.
            UncertaintyError: a level outside (0, 1), or no groups where they are needed.
        """
        return self._pick(self._alpha(level), joint=False, groups=groups)

    def joint_quantile(
        self, level: float | Fraction, *, groups: Sequence[str] | None = None
    ) -> Tensor:
        """() q of the joint score max_j s_j / scale_j; (n,) by group; else as :meth:`quantile`."""
        return self._pick(self._alpha(level), joint=True, groups=groups)[..., 0]

    def predict(
        self,
        mean: Tensor,
        std: Tensor,
        level: float | Fraction,
        *,
        groups: Sequence[str] | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
    ) -> Intervals:
        """Intervals of new predictions (eq. 5), each of which holds its output at the level.

        Args:
            mean: (..., D) ŷ.
            std: (..., D) σ.
            level: coverage level 1-α in (0, 1), any.
            groups: one label per row, where the method needs them.
            bounds: (..., D) lower and upper quantile outputs, where the method needs them.

        Raises:
            NotCalibratedError: before :meth:`fit` or a load.
            UncertaintyError: wrong shapes, values that are not finite, groups or bounds that the
                method needs missing, σ = 0 without a floor, or a level outside (0, 1).
        """
        quantile = self._pick(self._alpha(level), joint=False, groups=groups)
        return self._widen(mean, std, quantile, float(level), bounds=bounds, joint=False)

    def predict_joint(
        self,
        mean: Tensor,
        std: Tensor,
        level: float | Fraction,
        *,
        groups: Sequence[str] | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
        method: Literal["max", "bonferroni"] = "max",
    ) -> Intervals:
        """A box per prediction that holds all D outputs at once at the level.

        Arguments and errors are those of :meth:`predict`. The method "max" takes one quantile of
        the largest score of a frame, and is exact; "bonferroni" takes each output at level 1 - α/D,
        which is wider and needs D times the samples; another is a ConfigurationError.
        """
        alpha = self._alpha(level)
        if method == "max":
            quantile = self._pick(alpha, joint=True, groups=groups)
            if len(self.scales):
                quantile = quantile * self.scales.to(quantile)
        elif method == "bonferroni":
            quantile = self._pick(alpha / self.scores.shape[1], joint=False, groups=groups)
        else:
            raise ConfigurationError(f'method = "{method}"; choose "max" or "bonferroni".')
        return self._widen(mean, std, quantile, float(level), bounds=bounds, joint=True)

    @abstractmethod
    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        """What the method widens: (..., D) predictions, σ floored, bounds not yet checked."""

    def _learn(self, scores: Tensor, groups: Sequence[str]) -> None:
        """Put (m, D) scores into buffers, sorted; ``groups`` has m labels if they are needed."""
        self.scores = scores.sort(dim=0).values
        self.joint_scores = self._joint(scores).sort().values

    def _pick(self, alpha: Fraction, *, joint: bool, groups: Sequence[str] | None) -> Tensor:
        """(D,) q per output or (1,) jointly; with a leading n where it depends on the group."""
        table = self._table(joint=joint)
        rank = conformal_rank(len(table), alpha)
        if rank <= len(table):
            return table[rank - 1].clone()
        if self._first_time(alpha):
            warn_too_few(len(table), alpha, stacklevel=4)
        return torch.full_like(table[0], torch.inf)

    def _joint(self, scores: Tensor) -> Tensor:
        """(m,) max_j s_j / scale_j."""
        return (scores / self.scales.to(scores) if len(self.scales) else scores).amax(1)

    def _table(self, *, joint: bool) -> Tensor:
        """(m, D) sorted scores per output, or (m, 1) of the joint score."""
        return self.joint_scores[:, None] if joint else self.scores

    def _widen(
        self,
        mean: Tensor,
        std: Tensor,
        quantile: Tensor,
        level: float,
        *,
        bounds: tuple[Tensor, Tensor] | None,
        joint: bool,
    ) -> Intervals:
        size = self.scores.shape[1]
        if mean.shape != std.shape or mean.ndim == 0 or mean.shape[-1] != size:
            raise UncertaintyError(
                f"mean {tuple(mean.shape)} and std {tuple(std.shape)}: both must be "
                f"(..., {size}), the outputs that the calibrator was fitted on."
            )
        self._check.finite("mean", mean)
        self._check.finite("std", std)
        mean, std = at_least_float32(mean), self._used_std(at_least_float32(std))
        if quantile.ndim == 2:
            rows = mean.shape[:-1].numel()
            if len(quantile) != rows:
                raise UncertaintyError(
                    f"{len(quantile)} groups for {rows} rows: give one label per row."
                )
            quantile = quantile.reshape(*mean.shape[:-1], quantile.shape[1])
        lower, upper = self._anchors(mean, std, bounds).widened(quantile.to(mean))
        return Intervals(mean, std, lower, upper, level, joint)

    def _alpha(self, level: float | Fraction) -> Fraction:
        if not self.is_fitted:
            raise NotCalibratedError(
                "The calibrator holds no scores: call fit(mean, std, target) on the uncertainty "
                "calibration set, or load the state of a fitted one, before asking for intervals."
            )
        try:
            return miscoverage(level)
        except ValueError as error:
            raise UncertaintyError(str(error)) from None

    def _used_std(self, std: Tensor) -> Tensor:
        """The σ with its floor if the method divides by it, else as it is."""
        return self._check.floored(std, float(self.sigma_floor)) if self.needs_std else std
