"""Which edges of a sweep a frame keeps: those near the image, strong ones, of every kind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.edges.sweep import KINDS

SHARES: tuple[float, ...] = (0.24, 0.10, 0.20, 0.16, 0.10, 0.20)
"""Share of each of :data:`~uncal.edges.sweep.KINDS` where there are more edges than wanted."""


def select_edges(edges: NDArray[np.float32], most: int, seed: int) -> NDArray[np.float32]:
    """Keep the strongest of each kind, in an order that makes any first part a fair sample.

    A real sweep has many times the intensity edges of a simulated one, most of them noise; kinds
    have quotas so that they do not crowd out the others. What one kind does not need goes to the
    others.

    Args:
        edges: (m, columns) of one frame.
        most: how many to keep at most.
        seed: of the order.

    Returns:
        (min(m, most), columns), or a few fewer since quotas are whole numbers; shuffled.
    """
    kind = edges[:, 3].astype(int)
    counts = np.bincount(kind, minlength=len(KINDS))
    quota = _quotas(counts, most)
    kept = []
    for number, (count, allowed) in enumerate(zip(counts, quota, strict=True)):
        index = np.flatnonzero(kind == number)
        if count > allowed:
            index = index[np.argsort(-edges[index, 5], kind="stable")[:allowed]]
        kept.append(index)
    order = np.random.default_rng(seed).permutation(np.concatenate(kept))
    return np.asarray(edges[order], np.float32)


def _quotas(counts: NDArray[np.intp], most: int) -> list[int]:
    """Edges to keep of each kind."""
    allowed = np.minimum(counts, 0)
    free = np.ones(len(counts), bool)
    for _ in range(len(counts)):
        left = most - allowed[~free].sum()
        share = np.where(free, SHARES, 0.0)
        if share.sum() == 0:
            break
        offered = np.floor(left * (share / share.sum())).astype(int)
        full = free & (counts <= offered)
        allowed = np.where(free, np.minimum(counts, offered), allowed)
        if not full.any():
            break
        free &= ~full
    return [int(n) for n in allowed]
