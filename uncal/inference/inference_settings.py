"""The groups ``mcd`` and ``interval`` as classes that check themselves and make what they set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TypeVar, cast

from hydra.utils import instantiate
from omegaconf import DictConfig
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.models.split_prediction import SPREADS
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.mc_dropout import MCDropout, SinglePass

_Settings = TypeVar("_Settings", "DropoutSettings", "IntervalSettings")


@dataclass(frozen=True, kw_only=True)
class DropoutSettings:
    """Stochastic passes: the keys of ``conf/mcd/paper.yaml``, which says what each means.

    Raises:
        ConfigurationError: another kind of σ or of masks than there is.
    """

    passes: int
    strategy: str
    chunk: int | str | None
    masks: str
    layers: Sequence[str] | None
    seed: int
    insert: Mapping[str, object] | None
    spread: str

    def __post_init__(self) -> None:
        """Check the words."""
        choice("mcd.spread", self.spread, SPREADS)
        choice("mcd.masks", self.masks, ("random", "fixed"))

    def engine(self, network: nn.Module, masks: FixedMasks | None) -> MCDropout:
        """MC dropout of a network, or a single pass without dropout."""
        if self.passes == 1:
            return SinglePass(network)
        return MCDropout(
            network,
            self.passes,
            self.chunk,
            strategy=self.strategy,
            masks=masks,
            select=self.layers,
        )


@dataclass(frozen=True, kw_only=True)
class IntervalSettings:
    """The interval method: the keys of ``conf/interval``, where each is explained.

    Raises:
        ConfigurationError: frames grouped by anything but rig or drive.
    """

    levels: Sequence[float]
    sigma_floor: float
    groups: str
    quantile_levels: tuple[float, float]
    calibrator: Callable[..., IntervalCalibrator]

    def __post_init__(self) -> None:
        """Check the words."""
        choice("interval.groups", self.groups, ("rig", "drive"))

    def make(
        self, network: nn.Module, dropout: DropoutSettings, bounds: Tensor
    ) -> IntervalCalibrator:
        """The calibrator, unfitted, of a network's outputs and their (6,) range, m and rad.

        Raises:
            ConfigurationError: it needs σ or quantiles that there are not.
        """
        kind = cast("type[IntervalCalibrator]", getattr(self.calibrator, "func", self.calibrator))
        if kind.needs_bounds and not gives_quantiles(network):
            backbone = "" if hasattr(network, "backbone") else "model/backbone=mobilevit_xxs "
            raise ConfigurationError(
                f"interval: {kind.__name__} widens quantiles that the network gives, and this one "
                f"gives none: add {backbone}model/head=quantile"
            )
        if kind.needs_std and dropout.passes == 1 and dropout.spread == "dropout":
            raise ConfigurationError(
                f"mcd.passes=1 is one pass without dropout and has no σ, which {kind.__name__} "
                "needs: set at least 2 (the paper: 25), or choose interval=absolute or interval=cqr"
            )
        # Without σ the joint score would compare metres with radians.
        scales = {} if kind.needs_std else {"scales": bounds.tolist()}
        return self.calibrator(names=DOF_NAMES, **scales)


def gives_quantiles(network: nn.Module) -> bool:
    """Whether a network has a head whose class says ``gives_quantiles = True``."""
    return any(getattr(module, "gives_quantiles", False) for module in network.modules())


def read_settings(kind: type[_Settings], name: str, section: DictConfig) -> _Settings:
    """Make settings of a group of the configuration, or name a key added by force."""
    known = [field.name for field in fields(kind)]
    if unknown := [f"{name}.{key!s}" for key in section if key not in known]:
        raise ConfigurationError(
            f"{', '.join(unknown)}: nothing reads this; {name} has {', '.join(known)}"
        )
    return kind(**cast("Mapping[str, object]", instantiate(section, _convert_="all")))  # type: ignore[arg-type]


def choice(name: str, value: str, known: Sequence[str]) -> str:
    """One of a few words; another is a ConfigurationError with the key's name and the words."""
    if value not in known:
        raise ConfigurationError(f"{name}={value}: expected {' or '.join(known)}")
    return value
