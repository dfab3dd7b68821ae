"""Whether images and scans are of the same moments, by comparing each image with several scans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # type: ignore[import-untyped]

from uncal.checking.evidence import View, agreement
from uncal.checking.finding import Finding

LONGEST_LAG = 2
"""Frames by which scans are shifted against images."""

_BETTER = 1.1
_MAJORITY = 0.75
_SIGNIFICANT = 3.0


def agreements(views: Sequence[View]) -> NDArray[np.float64]:
    """(images, scans) agreement of every image with every scan of consecutive frames."""
    n = len(views)
    table = np.full((n, n), np.nan)
    for i, image in enumerate(views):
        for j, scan in enumerate(views):
            pair = image._replace(edges=scan.edges, along=scan.along, weights=scan.weights)
            table[i, j] = float(agreement(pair, image.T[None])[0])
    return np.asarray(np.nan_to_num(table))


def of_pairs(drive: str, runs: Sequence[Sequence[View]]) -> list[Finding]:
    """Scans that fit another image better than their own, in stretches of consecutive frames."""
    tables = [agreements(views) for views in runs]
    for lag in sorted(set(range(-LONGEST_LAG, LONGEST_LAG + 1)) - {0}, key=abs):
        gains = np.concatenate([_gain(table, lag) for table in tables])
        own = np.concatenate([np.diag(table) for table in tables])
        if len(gains) >= 3 and _clear(gains, own):
            return [_said(drive, f"images fit the scan {lag:+d} better than their own in "
                          f"{int((gains > 0).sum())} of {len(gains)} frames")]  # fmt: skip
    moved, total, gain, own_mean = 0, 0, 0.0, 0.0
    for table in tables:
        rows, columns = linear_sum_assignment(-table)
        moved += int((rows != columns).sum())
        total += len(rows)
        gain += float(table[rows, columns].sum() - np.trace(table))
        own_mean += float(np.trace(table))
    if total >= 4 and moved >= 0.5 * total and gain > 0.25 * max(own_mean, 1e-6):
        return [_said(drive, f"{moved} of {total} images fit another scan of the drive better")]
    return []


def _gain(table: NDArray[np.float64], lag: int) -> NDArray[np.float64]:
    """Of every image that has a scan so many frames later, over its own scan."""
    own = np.diag(table)
    other = np.diag(table, lag)
    return other - (own[: len(other)] if lag > 0 else own[len(own) - len(other) :])


def _clear(gains: NDArray[np.float64], own: NDArray[np.float64]) -> bool:
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return bool(
        (gains > 0).mean() >= _MAJORITY
        and gains.mean() > _SIGNIFICANT * error
        and gains.mean() > (_BETTER - 1.0) * max(float(own.mean()), 0.0)
    )


def _said(drive: str, seen: str) -> Finding:
    return Finding(
        "clock",
        drive,
        seen,
        "each image with the scan of its own moment",
        "compare the clocks of both sensors; pair by time, not by number, and keep the order",
    )
