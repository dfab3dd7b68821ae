"""The learning rate of a training that goes on: as if it had never stopped."""

from __future__ import annotations

from collections.abc import Iterable

from torch.optim.lr_scheduler import LambdaLR


def follow(schedulers: Iterable[object]) -> None:
    """Give every optimiser the rate that its schedule has for the coming step.

    A checkpoint brings the rate of the schedule that it was made under. In a training resumed with
    another length the first step would still follow that one; with the same length this changes
    nothing, to the last bit.

    Args:
        schedulers: of a training; those that are no :class:`LambdaLR` are left alone.
    """
    for scheduler in schedulers:
        if not isinstance(scheduler, LambdaLR):
            continue
        groups = scheduler.optimizer.param_groups
        parts = zip(groups, scheduler.base_lrs, scheduler.lr_lambdas, strict=True)
        for group, base, factor in parts:
            group["lr"] = base * factor(scheduler.last_epoch)
