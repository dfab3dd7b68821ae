"""A resumed training steps at the rate of the schedule that it now has."""

from __future__ import annotations

import pytest
import torch
from torch.optim.lr_scheduler import LambdaLR

from uncal.models.module import follow


def started(total: int) -> LambdaLR:
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=0.1)
    return LambdaLR(optimizer, lambda step: 1 - step / total)


def advanced(scheduler: LambdaLR, steps: int) -> LambdaLR:
    for _ in range(steps):
        scheduler.optimizer.step()
        scheduler.step()
    return scheduler


@pytest.mark.parametrize(("total", "resumed"), [(10, 10), (10, 20), (20, 7)])
def test_the_first_step_after_resuming_follows_the_new_schedule(total: int, resumed: int) -> None:
    before = advanced(started(total), 4)
    after = started(resumed)
    after.optimizer.load_state_dict(before.optimizer.state_dict())
    after.load_state_dict(before.state_dict())
    assert after.optimizer.param_groups[0]["lr"] == before.optimizer.param_groups[0]["lr"]
    follow([after, object()])
    never_stopped = advanced(started(resumed), 4)
    assert after.optimizer.param_groups[0]["lr"] == never_stopped.optimizer.param_groups[0]["lr"]
