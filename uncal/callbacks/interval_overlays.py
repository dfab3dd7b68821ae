"""What an interval means on the image: points at its lower bound, its estimate, its upper bound."""

from __future__ import annotations

import logging
from pathlib import Path

import lightning
import numpy as np
from lightning import LightningModule, Trainer
from numpy.typing import NDArray
from torch import Tensor

from uncal.callbacks.overlays import keep_overlay
from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Sample
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES, DOF_SCALE
from uncal.geometry.decalibration import correct, decalibrate
from uncal.models.module import CalibrationModule
from uncal.reporting.evaluation import percent

log = logging.getLogger(__name__)


class IntervalOverlays(lightning.Callback):
    """Draws test frames from the widest interval of one DoF to the narrowest (the paper's figure).

    Args:
        folder: where the PNGs go.
        frames: how many, evenly spaced in rank: three are widest, median and narrowest.
        dof: whose bounds are shown, a name of :data:`uncal.geometry.DOF_NAMES`.
        level: coverage level of the interval, in (0, 1).
        label: what the data are, such as "simulated"; stands in every picture.

    Raises:
        ConfigurationError: another DoF.
    """

    def __init__(self, folder: str, frames: int, dof: str, level: float, label: str) -> None:
        if dof not in DOF_NAMES:
            raise ConfigurationError(f'dof = "{dof}": choose one of {", ".join(DOF_NAMES)}')
        self.folder, self.label = Path(folder), label
        self.frames, self.dof, self.level = frames, dof, level

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Choose by width, draw, log."""
        data = getattr(trainer, "datamodule", None)
        if not trainer.is_global_zero or not isinstance(data, CalibrationDataModule):
            return
        if not isinstance(pl_module, CalibrationModule) or pl_module.run.tested is None:
            return
        tested = pl_module.run.tested
        intervals = pl_module.intervals(tested, data.named("test"), self.level)
        j = DOF_NAMES.index(self.dof)
        lower, upper = intervals.lower[:, j], intervals.upper[:, j]
        ranks = chosen_by_width(upper - lower, self.frames)
        if not ranks:
            log.info("no overlays of intervals: at %g %% none is finite", percent(self.level))
        for rank, i in ranks.items():
            what = f"{rank} {percent(self.level):g}% interval of {len(lower)} ({self.label})"
            name = f"{self.dof.lower()}_{rank.replace(' ', '_')}"
            try:
                frames = data.datasets["test"][int(tested.index[i])]
                sample = next((each for each in frames if isinstance(each, Sample)), None)
                if sample is None:
                    continue
                estimate, target = tested.mean[i].double(), tested.target[i].double()
                T_init = decalibrate(sample.T_cam_lidar.double(), target)
                bounds = (lower[i].item(), upper[i].item())
                extrinsics = bound_extrinsics(T_init, estimate, target, bounds, self.dof, what)
                path = self.folder / f"interval_{name}.png"
                keep_overlay(trainer, data, sample, extrinsics, path, f"interval/{name}")
            except Exception as error:
                # Whatever it is: hours of training must not end here.
                log.error("%s was not drawn: %s: %s", what, type(error).__name__, error)


def chosen_by_width(width: Tensor, frames: int) -> dict[str, int]:
    """Frames from the widest interval to the narrowest, evenly spaced in rank.

    Infinite ones of the (n,) widths are passed over.

    Returns:
        What it is, such as "widest" → its number among the n.

    >>> import torch
    >>> chosen_by_width(torch.tensor([2.0, 5.0, torch.inf, 1.0]), frames=3)
    {'widest': 1, 'median': 0, 'narrowest': 3}
    """
    order = [i for i in width.argsort(descending=True, stable=True).tolist() if width[i].isfinite()]
    if not order:
        return {}
    last = len(order) - 1
    names = {last // 2: "median", last: "narrowest", 0: "widest"}
    ranks = np.linspace(0, last, min(frames, len(order))).astype(int).tolist()
    return {names.get(rank, f"rank {rank + 1}"): order[rank] for rank in ranks}


def bound_extrinsics(
    T_init: Tensor,
    estimate: Tensor,
    target: Tensor,
    bounds: tuple[float, float],
    dof: str,
    what: str,
) -> dict[str, NDArray[np.float64]]:
    """Caption → (4, 4) corrected by the estimate, of which one DoF stands at a bound or not at all.

    Captions are plain ASCII, which OpenCV can draw.
    """
    j = DOF_NAMES.index(dof)
    unit, digits = ("cm", 1) if j < 3 else ("deg", 2)

    def shown(value: float, sign: str) -> str:
        return f"{DOF_SCALE[j] * value:{sign}.{digits}f} {unit}"

    def corrected(value: float) -> NDArray[np.float64]:
        moved = estimate.clone()
        moved[j] = value
        return correct(T_init, moved).numpy()

    lower, upper = bounds
    middle, truth = estimate[j].item(), target[j].item()
    off, width = shown(middle - truth, "+"), shown(upper - lower, "")
    below, above = shown(lower - middle, "+"), shown(upper - middle, "+")
    return {
        f"{dof} at its lower bound: {below} from the estimate": corrected(lower),
        f"{dof} as estimated: off by {off}; {what}, {width} wide": corrected(middle),
        f"{dof} at its upper bound: {above} from the estimate": corrected(upper),
    }
