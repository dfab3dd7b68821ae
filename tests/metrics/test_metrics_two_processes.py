"""All metrics under two gloo processes give what one process gives."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch import distributed as dist
from torch.multiprocessing.spawn import spawn
from torchmetrics import Metric

from uncal.metrics import MPIW, PICP, IntervalScore

N = 31
SHARES = {"unequal": [slice(0, 20), slice(20, N)], "one empty": [slice(0, 0), slice(0, N)]}
KINDS = ("finite", "infinite")


def _metrics() -> dict[str, Metric]:
    return {
        "picp": PICP(6),
        "mpiw": MPIW(6),
        "is": IntervalScore(6, alpha=0.1),
    }


def _update(metrics: dict[str, Metric], kind: str, part: slice) -> None:
    """Add the samples of a part, in two batches if there are as many."""
    generator = torch.Generator().manual_seed(0)
    lower, target = torch.randn(2, N, 6, generator=generator).unbind()
    upper = lower + 3 * torch.rand(N, 6, generator=generator)
    if kind == "infinite":  # each in another process where the parts are two
        upper[0, 2], lower[25] = torch.inf, -torch.inf
        upper[24, 4] = lower[24, 4]
    rows = range(N)[part]
    half = len(rows) // 2
    for batch in (list(rows[:half]), list(rows[half:])):
        if not batch:
            continue
        low, high, truth = lower[batch], upper[batch], target[batch]
        for metric in metrics.values():
            metric.update(low, high, truth)


def _computed(metrics: dict[str, Metric]) -> dict[str, list[Tensor]]:
    values = {name: metric.compute() for name, metric in metrics.items()}
    return {name: [v] if isinstance(v, Tensor) else list(v) for name, v in values.items()}


def _work(rank: int, folder: str) -> None:
    dist.init_process_group("gloo", init_method=f"file://{folder}/init", rank=rank, world_size=2)
    torch.set_num_threads(1)  # two processes may share few cores
    results = {}
    for share, parts in SHARES.items():
        for kind in KINDS:
            metrics = _metrics()
            _update(metrics, kind, parts[rank])
            results[f"{share}, {kind}"] = _computed(metrics)
    torch.save(results, Path(folder) / f"{rank}.pt")
    dist.destroy_process_group()


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    """What each of two processes computes; started once, since starting is what takes long."""
    folder = tmp_path_factory.mktemp("metrics")
    spawn(_work, args=(str(folder),), nprocs=2)  # type: ignore[no-untyped-call]
    return [torch.load(folder / f"{rank}.pt") for rank in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", SHARES)
def test_two_processes_give_what_one_gives(
    two_processes: list[dict[str, object]], share: str, kind: str
) -> None:
    metrics = _metrics()
    _update(metrics, kind, slice(0, N))
    alone = _computed(metrics)
    for saved in two_processes:
        found = saved[f"{share}, {kind}"]
        assert isinstance(found, dict)
        assert list(found) == list(alone)
        for name, values in alone.items():
            for value, expected in zip(found[name], values, strict=True):
                torch.testing.assert_close(value, expected, equal_nan=True, msg=name)
    if kind == "infinite":
        assert alone["mpiw"][0].isinf().all()
        assert alone["is"][0].isinf().all()
