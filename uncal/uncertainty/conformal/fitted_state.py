"""What an interval method has learned, kept in buffers so that it travels in any checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import ClassVar, TypeVar

import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError, NotCalibratedError, PredictorMismatchError
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity

_Self = TypeVar("_Self", bound="CalibratorState")


class CalibratorState(nn.Module):
    """Sorted scores and the identity of the predictor that they belong to.

    Survives ``state_dict``, also into a fresh instance whose buffers are still empty, and loads
    with ``weights_only=True``. ``.to(device)`` moves the buffers; a cast leaves them alone. The
    state of another kind of calibrator is refused: the same scores would mean other intervals.
    Arguments and errors are those of :class:`uncal.uncertainty.IntervalCalibrator`.
    """

    kind: ClassVar[str]
    """The interval method's short name, in the state and in messages."""

    scores: Tensor
    """(m, D) nonconformity scores, sorted along dimension 0."""
    joint_scores: Tensor
    """(m,) scores of all outputs together, sorted."""
    count: Tensor
    """m, int64; 0 before the fit."""
    sigma_floor: Tensor
    """The smallest σ to divide by."""
    scales: Tensor
    """(D,) scales of the joint score, float64; empty for ones."""
    passes: Tensor
    """N of the predictor that was calibrated, int64; 0 if unknown."""
    dropout_rates: Tensor
    """(L,) p of its dropout layers in module order, float64."""
    weights_digest: Tensor
    """(32,) uint8, SHA-256 of its weights; empty if unknown."""
    masks_digest: Tensor
    """uint8, digest of its fixed dropout masks; empty for fresh random masks."""
    written_by: Tensor
    """uint8, :attr:`kind` in UTF-8."""

    def __init__(self, sigma_floor: float, scales: Sequence[float] | None) -> None:
        super().__init__()
        if not 0 <= sigma_floor < float("inf"):
            raise ConfigurationError(
                f"sigma_floor = {sigma_floor}; it must be finite and at least 0 (0: no floor)."
            )
        units = torch.tensor([] if scales is None else list(scales), dtype=torch.float64)
        if not ((units > 0) & units.isfinite()).all():
            raise ConfigurationError(
                f"scales = {units.tolist()}; each must be positive and finite, for instance the "
                "largest decalibration per output."
            )
        self.register_buffer("scores", torch.empty(0, 0))
        self.register_buffer("joint_scores", torch.empty(0))
        self.register_buffer("count", torch.tensor(0))
        self.register_buffer("sigma_floor", torch.tensor(float(sigma_floor)))
        self.register_buffer("scales", units)
        self.register_buffer("passes", torch.tensor(0))
        self.register_buffer("dropout_rates", torch.empty(0, dtype=torch.float64))
        self.register_buffer("weights_digest", torch.empty(0, dtype=torch.uint8))
        self.register_buffer("masks_digest", torch.empty(0, dtype=torch.uint8))
        self.register_buffer("written_by", _bytes(self.kind.encode(), torch.device("cpu")))
        self._warned: set[tuple[Fraction, str]] = set()

    @property
    def is_fitted(self) -> bool:
        """Whether there was a fit, here or in the loaded state."""
        return int(self.count) > 0

    @property
    def identity(self) -> PredictorIdentity | None:
        """The predictor that the scores belong to, if the fit was told."""
        if self.weights_digest.numel() == 0:
            return None
        weights = bytes(self.weights_digest.tolist()).hex()
        masks = bytes(self.masks_digest.tolist()).hex()
        rates = tuple(self.dropout_rates.tolist())
        return PredictorIdentity(weights, int(self.passes), rates, masks)

    def check_matches(self, identity: PredictorIdentity) -> None:
        """Refuse a predictor, known by ``MCDropout.identity()``, other than the one calibrated.

        Raises:
            NotCalibratedError: before a fit or a load.
            PredictorMismatchError: other weights, passes, dropout rates or masks, or none on
                record.
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
                "The calibrator was fitted with another predictor, so that nothing guarantees the "
                f"coverage of its intervals here ({'; '.join(differences)}). Use the predictor it "
                "was calibrated with, or calibrate again."
            )

    def _record(self, count: int, identity: PredictorIdentity | None, device: torch.device) -> None:
        """Note how many samples were seen, and of which predictor."""
        self.count = torch.tensor(count, device=device)
        self.sigma_floor, self.scales = self.sigma_floor.to(device), self.scales.to(device)
        self.written_by = self.written_by.to(device)
        known = PredictorIdentity("", 0, ()) if identity is None else identity
        self.passes = torch.tensor(known.passes, device=device)
        self.dropout_rates = torch.tensor(known.rates, dtype=torch.float64, device=device)
        self.weights_digest = _bytes(bytes.fromhex(known.weights), device)
        self.masks_digest = _bytes(bytes.fromhex(known.masks), device)
        self._warned.clear()

    def _first_time(self, alpha: Fraction, subject: str = "") -> bool:
        """Whether nothing was said of this level (and subject) since the last fit or load."""
        new = (alpha, subject) not in self._warned
        self._warned.add((alpha, subject))
        return new

    def _apply(self: _Self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> _Self:
        """Move, but never cast: scores in bfloat16 would be other quantiles."""

        def move(tensor: Tensor) -> Tensor:
            moved = fn(tensor)
            return moved if moved.dtype == tensor.dtype else tensor.to(moved.device)

        super()._apply(move, recurse)  # type: ignore[no-untyped-call]
        return self

    def _load_from_state_dict(
        self,
        state_dict: Mapping[str, Tensor],
        prefix: str,
        local_metadata: dict[str, object],
        strict: bool,
        missing_keys: list[str],
        unexpected_keys: list[str],
        error_msgs: list[str],
    ) -> None:
        """Take over the incoming sizes and types first: a fresh instance has empty buffers."""
        state = dict(state_dict)
        if prefix + "scores" in state:
            writer = bytes(state[prefix + "written_by"].tolist()).decode()
            if writer != self.kind:
                error_msgs.append(
                    f'{prefix.rstrip(".") or "calibrator"}: this is the state of a "{writer}" '
                    f'calibrator, and this one is "{self.kind}": build the kind that was saved, '
                    "or fit anew."
                )
                return
        # Buffers made in inference mode (Lightning's loops) could not be written to outside it.
        with torch.inference_mode(False):
            for name, buffer in list(self._buffers.items()):
                incoming = state.get(prefix + name)
                if incoming is not None and buffer is not None:
                    setattr(self, name, torch.empty_like(incoming, device=buffer.device))
        super()._load_from_state_dict(
            state, prefix, local_metadata, strict, missing_keys, unexpected_keys, error_msgs
        )
        self._warned.clear()


def _bytes(content: bytes, device: torch.device) -> Tensor:
    return torch.tensor(list(content), dtype=torch.uint8, device=device)
