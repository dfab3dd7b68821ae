"""What an interval method has learned, kept in buffers so that it travels in any checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.uncertainty.errors import NotCalibratedError, PredictorMismatchError
from uncal.uncertainty.fingerprint import PredictorIdentity

_Self = TypeVar("_Self", bound="CalibratorState")


class CalibratorState(nn.Module):
    """Sorted scores and the identity of the predictor that they belong to.

    Survives ``state_dict``, also into a fresh instance whose buffers are still empty, and loads
    with ``weights_only=True``. ``.to(device)`` moves the buffers; a cast leaves them alone.

    Args:
        sigma_floor: smallest σ to divide by, in the network's own units; a loaded state brings
            its own.

    Raises:
        ConfigurationError: a negative or non-finite floor.
    """

    scores: Tensor
    """(m, D) nonconformity scores, sorted along dimension 0."""
    count: Tensor
    """m, int64; 0 before the fit."""
    sigma_floor: Tensor
    """The smallest σ to divide by."""
    passes: Tensor
    """N of the predictor that was calibrated, int64; 0 if unknown."""
    dropout_rates: Tensor
    """(L,) p of its dropout layers in module order, float64."""
    weights_digest: Tensor
    """(32,) uint8, SHA-256 of its weights; empty if unknown."""

    def __init__(self, sigma_floor: float) -> None:
        """Make the empty buffers."""
        super().__init__()
        if not 0 <= sigma_floor < float("inf"):
            raise ConfigurationError(
                f"sigma_floor = {sigma_floor}; it must be finite and at least 0 (0: no floor)."
            )
        self.register_buffer("scores", torch.empty(0, 0))
        self.register_buffer("count", torch.tensor(0))
        self.register_buffer("sigma_floor", torch.tensor(float(sigma_floor)))
        self.register_buffer("passes", torch.tensor(0))
        self.register_buffer("dropout_rates", torch.empty(0, dtype=torch.float64))
        self.register_buffer("weights_digest", torch.empty(0, dtype=torch.uint8))

    @property
    def is_fitted(self) -> bool:
        """Whether there are scores, from a fit or from a loaded state."""
        return len(self.scores) > 0

    @property
    def identity(self) -> PredictorIdentity | None:
        """The predictor that the scores belong to, if the fit was told."""
        if self.weights_digest.numel() == 0:
            return None
        weights = bytes(self.weights_digest.tolist()).hex()
        return PredictorIdentity(weights, int(self.passes), tuple(self.dropout_rates.tolist()))

    def check_matches(self, identity: PredictorIdentity) -> None:
        """Refuse a predictor other than the one that was calibrated.

        Args:
            identity: the predictor about to be used, ``MCDropout.identity()``.

        Raises:
            NotCalibratedError: before a fit or a load.
            PredictorMismatchError: other weights, passes or dropout rates, or none on record.
        """
        if not self.is_fitted:
            raise NotCalibratedError(
                "There is no calibrated predictor to compare with: call fit, or load the state "
                "of a fitted calibrator."
            )
        known = self.identity
        if known is None:
            raise PredictorMismatchError(
                "The calibrator was fitted without the predictor's identity, so that nothing can "
                "be checked: fit it with fit(..., identity=mc_dropout.identity())."
            )
        if differences := known.differences(identity):
            raise PredictorMismatchError(
                "The calibrator was fitted with another predictor, so that its intervals promise "
                f"nothing here ({'; '.join(differences)}). Use the predictor it was calibrated "
                "with, or calibrate again."
            )

    def _keep(self, scores: Tensor, identity: PredictorIdentity | None) -> None:
        """Replace what is known by (m, D) unsorted scores and where they come from."""
        device = scores.device
        self.scores = scores.sort(dim=0).values
        self.count = torch.tensor(len(scores), device=device)
        self.sigma_floor = self.sigma_floor.to(device)
        digest = b"" if identity is None else bytes.fromhex(identity.weights)
        rates = () if identity is None else identity.rates
        self.passes = torch.tensor(0 if identity is None else identity.passes, device=device)
        self.dropout_rates = torch.tensor(rates, dtype=torch.float64, device=device)
        self.weights_digest = torch.tensor(list(digest), dtype=torch.uint8, device=device)

    def _apply(self: _Self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> _Self:
        """Move, but never cast: scores in bfloat16 would be other quantiles."""

        def move(tensor: Tensor) -> Tensor:
            moved = fn(tensor)
            return moved if moved.dtype == tensor.dtype else tensor.to(moved.device)

        super()._apply(move, recurse)  # type: ignore[no-untyped-call]
        return self

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Tensor], prefix: str, *args: object
    ) -> None:
        """Take over the incoming sizes and types first: a fresh instance has empty buffers."""
        # Buffers made in inference mode (Lightning's loops) could not be written to outside it.
        with torch.inference_mode(False):
            for name, buffer in list(self._buffers.items()):
                incoming = state_dict.get(prefix + name)
                if incoming is not None and buffer is not None:
                    setattr(self, name, torch.empty_like(incoming, device=buffer.device))
        super()._load_from_state_dict(state_dict, prefix, *args)
