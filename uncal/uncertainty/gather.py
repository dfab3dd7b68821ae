"""Bring the samples that several processes hold together, each sample once, in one order."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch import distributed as dist

from uncal.uncertainty.errors import UncertaintyError


class _Rows(NamedTuple):
    """What one process brings: the others need to know before the rows are exchanged.

    Attributes:
        n: rows that it holds.
        kinds: per tensor the shape of a row and the number type.
        device: "cpu" or "cuda".
        complaint: what is wrong with its arguments; "" if nothing.
    """

    n: int
    kinds: tuple[tuple[torch.Size, torch.dtype], ...]
    device: str
    complaint: str


def gather_by_id(ids: Tensor, *tensors: Tensor) -> tuple[Tensor, ...]:
    """All processes' rows, each id once, sorted by id: the same on every process.

    A distributed sampler repeats samples to give every process as many. A repeated sample would
    count twice in a conformal quantile and break its guarantee; here the first occurrence in rank
    order stays, whatever the others hold. Without torch.distributed, or with one process, the rows
    given are made unique and sorted just the same. Numbers travel as bytes, hence exactly.

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
    ours = _Rows(
        n=len(ids) if ids.ndim else 0,
        kinds=tuple((tensor.shape[1:], tensor.dtype) for tensor in columns),
        device=ids.device.type,
        complaint=_complaint(columns),
    )
    if dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1:
        everyone: list[_Rows] = [ours] * dist.get_world_size()
        dist.all_gather_object(everyone, ours)
        pattern = _agreed(everyone)
        devices = [tensor.device for tensor in columns]
        gathered = _exchange(columns, everyone, pattern)
        columns = tuple(tensor.to(device) for tensor, device in zip(gathered, devices, strict=True))
    elif ours.complaint:
        raise UncertaintyError(ours.complaint)
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
            "number per sample, such as its place in the split."
        )
    for position, tensor in enumerate(tensors):
        if tensor.ndim == 0 or len(tensor) != len(ids):
            return (
                f"tensor {position} of shape {tuple(tensor.shape)} for {len(ids)} ids: expected "
                f"({len(ids)}, ...), one row per id."
            )
    return ""


def _agreed(everyone: list[_Rows]) -> _Rows:
    """The first process that has samples says what a row looks like."""
    for rank, rows in enumerate(everyone):
        if rows.complaint:
            raise UncertaintyError(f"process {rank}: {rows.complaint}")
    pattern = next((rows for rows in everyone if rows.n), everyone[0])
    for rank, rows in enumerate(everyone):
        differs = rows.kinds != pattern.kinds if rows.n else False
        if differs or len(rows.kinds) != len(pattern.kinds):
            raise UncertaintyError(
                f"process {rank} brings {rows.n} rows of {_described(rows)}, another one rows "
                f"of {_described(pattern)}: pass the same tensors on every process."
            )
    return pattern


def _described(rows: _Rows) -> str:
    return ", ".join(f"{tuple(shape)} {dtype}" for shape, dtype in rows.kinds[1:]) or "ids alone"


def _exchange(
    columns: tuple[Tensor, ...], everyone: list[_Rows], pattern: _Rows
) -> tuple[Tensor, ...]:
    """All rows in rank order: one collective over rows packed into bytes, padded to one length."""
    device = _exchange_device(pattern.device)
    widths = [math.prod(shape) * dtype.itemsize for shape, dtype in pattern.kinds]
    longest = max(rows.n for rows in everyone)
    packed = torch.zeros(longest, sum(widths), dtype=torch.uint8, device=device)
    own = len(columns[0])
    for part, tensor in zip(torch.split(packed, widths, 1), columns, strict=True):
        if own and part.numel():
            part[:own] = tensor.to(device).reshape(own, -1).contiguous().view(torch.uint8)
    received = [torch.empty_like(packed) for _ in everyone]
    dist.all_gather(received, packed)
    joined = torch.cat([block[: rows.n] for block, rows in zip(received, everyone, strict=True)])
    # A copy each, since a view of other bytes must start where the new type may start.
    return tuple(
        part.clone(memory_format=torch.contiguous_format).view(dtype).reshape(-1, *shape)
        if part.numel()
        else torch.empty(len(joined), *shape, dtype=dtype, device=device)
        for part, (shape, dtype) in zip(torch.split(joined, widths, 1), pattern.kinds, strict=True)
    )


def _exchange_device(rows_on: str) -> torch.device:
    """Where the backend can exchange: nccl on the accelerator only, gloo on the CPU."""
    backend = dist.get_backend()
    if backend == "nccl" or (rows_on == "cuda" and backend != "gloo"):
        return torch.device("cuda", torch.cuda.current_device())
    return torch.device("cpu")
