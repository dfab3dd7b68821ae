"""One region for all outputs at once that follows their covariance: a conformal ellipsoid."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING, ClassVar, cast

import torch
from torch import Tensor

from uncal.errors import NotCalibratedError, UncertaintyError
from uncal.uncertainty.conformal.fitted_state import CalibratorState
from uncal.uncertainty.conformal.quantile import conformal_rank, miscoverage
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity

if TYPE_CHECKING:
    from typing_extensions import Self


class EllipsoidCalibrator(CalibratorState):
    """Ellipsoids {y : (y - ŷ)ᵀ Σ⁻¹ (y - ŷ) ≤ r²} that hold all outputs at once.

    The score is the Mahalanobis distance; r is the ⌈(m+1)(1-α)⌉-th smallest of those of the
    uncertainty calibration set, so that coverage is exact whatever Σ is. Where errors of the
    outputs are correlated and Σ knows it, an ellipsoid is smaller than any box.

    >>> target = torch.arange(1.0, 100.0)[:, None] * torch.tensor([[1.0, 0.0]])
    >>> unit = torch.eye(2).expand(99, 2, 2)
    >>> ellipsoid = EllipsoidCalibrator().fit(torch.zeros(99, 2), unit, target)
    >>> ellipsoid.radius(0.9).item()
    90.0
    """

    kind: ClassVar[str] = "ellipsoid"

    def __init__(self) -> None:
        """Make an unfitted calibrator."""
        super().__init__(0.0, None)

    def fit(
        self,
        mean: Tensor,
        covariance: Tensor,
        target: Tensor,
        *,
        identity: PredictorIdentity | None = None,
    ) -> Self:
        """Keep the sorted distances of the uncertainty calibration set.

        Args:
            mean: (m, D) ŷ.
            covariance: (m, D, D) Σ, positive definite.
            target: (m, D) the truth.
            identity: the predictor.

        Raises:
            UncertaintyError: wrong shapes, or a Σ that is not positive definite.
        """
        if mean.ndim != 2 or len(mean) == 0 or covariance.shape != (*mean.shape, mean.shape[1]):
            raise UncertaintyError(
                f"mean {tuple(mean.shape)}, covariance {tuple(covariance.shape)}: expected (m, D) "
                "and (m, D, D) with m ≥ 1 samples of the uncertainty calibration set."
            )
        with torch.inference_mode(False), torch.no_grad():
            distance = mahalanobis(mean.clone(), covariance.clone(), target.clone())
            self.scores = distance.sort().values[:, None]
            self.joint_scores = self.scores[:, 0].clone()
            self._record(len(mean), identity, mean.device)
        return self

    def radius(self, level: float | Fraction) -> Tensor:
        """() r at a coverage level; inf from too few samples.

        Args:
            level: coverage level 1-α in (0, 1).

        Raises:
            NotCalibratedError: before a fit or a load.
        """
        if not self.is_fitted:
            raise NotCalibratedError("The ellipsoid holds no scores: call fit before radius.")
        rank = conformal_rank(len(self.scores), miscoverage(level))
        if rank > len(self.scores):
            return self.scores.new_tensor(torch.inf)
        return self.scores[rank - 1, 0].clone()


def mahalanobis(mean: Tensor, covariance: Tensor, target: Tensor) -> Tensor:
    """√((y - ŷ)ᵀ Σ⁻¹ (y - ŷ)).

    Args:
        mean: (n, D) ŷ.
        covariance: (n, D, D) Σ.
        target: (n, D) y.

    Returns:
        (n,) distances.

    Raises:
        UncertaintyError: a Σ is not positive definite.
    """
    # Metres and radians differ by orders of magnitude: in units of σ the factors are stable.
    scale = covariance.diagonal(dim1=1, dim2=2).clamp_min(1e-30).sqrt().double()
    correlation = covariance.double() / scale[:, :, None] / scale[:, None]
    factor, failed = torch.linalg.cholesky_ex(correlation)
    if failed.any():
        raise UncertaintyError(
            f"{int((failed != 0).sum())} of {len(mean)} covariances are not positive definite: "
            "more stochastic passes than outputs are needed, or the solver's covariance "
            "(mcd.spread=solver or total)."
        )
    error = ((target - mean).double() / scale)[..., None]
    whitened = torch.linalg.solve_triangular(factor, error, upper=False)
    return cast(Tensor, whitened.square().sum((1, 2)).sqrt().to(mean.dtype))


def log_volume(covariance: Tensor, radius: Tensor) -> Tensor:
    """Natural logarithm of the ellipsoids' volumes, π^(D/2) / Γ(D/2 + 1) · r^D · √det Σ.

    Args:
        covariance: (n, D, D) Σ.
        radius: () r.

    Returns:
        (n,).

    >>> sphere = log_volume(torch.eye(3)[None], torch.tensor(1.0))
    >>> round(sphere.exp().item(), 3)
    4.189
    """
    size = covariance.shape[-1]
    unit = size / 2 * math.log(math.pi) - math.lgamma(size / 2 + 1)
    half_log_det = 0.5 * torch.linalg.slogdet(covariance.double()).logabsdet
    return cast(Tensor, unit + size * radius.double().log() + half_log_det)
