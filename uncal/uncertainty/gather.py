"""Bring the samples that several processes hold together, each sample once, in one order."""

from __future__ import annotations

import torch
from torch import Tensor
from torch import distributed as dist

from uncal.errors import UncertaintyError


def gather_by_id(ids: Tensor, *tensors: Tensor) -> tuple[Tensor, ...]:
    """All processes' rows, each id once, sorted by id: the same on every process.

    A distributed sampler repeats samples to give every process as many. A repeated sample would
    count twice in a conformal quantile and break its guarantee; here the first occurrence in rank
    order stays, whatever the others hold. Without torch.distributed, or with one process, the rows
    given are made unique and sorted just the same.

    Every process has to call it, one without samples too: it passes n = 0 rows of as many tensors,
    and the others decide what a row looks like. Under nccl each process must have set its current
    device. Nothing is differentiated.

    Args:
        ids: (n,) int64, what tells samples apart; n may differ between processes.
        *tensors: (n, ...) rows that belong to the ids.

    Returns:
        The (N,) sorted ids, then one (N, ...) tensor per argument, each on its argument's device.

    Raises:
        UncertaintyError: ids that are not (n,) int64, tensors of another length, or rows of other
            shapes or types on another process. It is raised on every process, so that none waits.

    >>> ids, mean = gather_by_id(torch.tensor([7, 2, 7]), torch.tensor([0.7, 0.2, 0.9]))
    >>> ids.tolist(), [round(value, 1) for value in mean.tolist()]
    ([2, 7], [0.2, 0.7])
    """
    columns = tuple(tensor.detach() for tensor in (ids, *tensors))
    complaint = _complaint(columns)
    if dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1:
        ours = (complaint, tuple(tensor.cpu() for tensor in columns))
        everyone: list[tuple[str, tuple[Tensor, ...]]] = [ours] * dist.get_world_size()
        dist.all_gather_object(everyone, ours)
        held = zip(*_agreed(everyone), strict=True)
        columns = tuple(torch.cat(h).to(own.device) for h, own in zip(held, columns, strict=True))
    elif complaint:
        raise UncertaintyError(complaint)
    order = columns[0].argsort(stable=True)
    in_order = columns[0][order]
    is_first = torch.ones_like(in_order, dtype=torch.bool)
    is_first[1:] = in_order[1:] != in_order[:-1]
    chosen = order[is_first]
    return tuple(tensor[chosen.to(tensor.device)] for tensor in columns)


def _complaint(columns: tuple[Tensor, ...]) -> str:
    """Why these arguments cannot be gathered; an exception now would leave the others waiting."""
    ids, *tensors = columns
    if ids.ndim != 1 or ids.dtype != torch.int64:
        return (
            f"ids of shape {tuple(ids.shape)} and type {ids.dtype}: expected (n,) int64, one "
            "number per sample, such as its index in the split."
        )
    for position, tensor in enumerate(tensors):
        if tensor.ndim == 0 or len(tensor) != len(ids):
            return (
                f"tensor {position} of shape {tuple(tensor.shape)} for {len(ids)} ids: expected "
                f"({len(ids)}, ...), one row per id."
            )
    return ""


def _agreed(everyone: list[tuple[str, tuple[Tensor, ...]]]) -> list[tuple[Tensor, ...]]:
    """The columns of the processes with rows, of which the first says what a row looks like."""
    for rank, (complaint, _) in enumerate(everyone):
        if complaint:
            raise UncertaintyError(f"process {rank}: {complaint}")
    held = [columns for _, columns in everyone]
    pattern = next((columns for columns in held if len(columns[0])), held[0])
    for rank, columns in enumerate(held):
        n = len(columns[0])
        if len(columns) != len(pattern) or (n and _row(columns) != _row(pattern)):
            raise UncertaintyError(
                f"process {rank} brings {n} rows of {_row(columns)}, another one rows of "
                f"{_row(pattern)}: pass the same tensors on every process."
            )
    return [columns for columns in held if len(columns[0])] or [pattern]


def _row(columns: tuple[Tensor, ...]) -> str:
    return ", ".join(f"{tuple(t.shape[1:])} {t.dtype}" for t in columns[1:]) or "ids alone"
