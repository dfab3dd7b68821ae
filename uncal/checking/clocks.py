"""Whether images and scans are of the same moments, by comparing each image with several scans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # type: ignore[import-untyped]

from uncal.checking.evidence import View, agreement, peak_height
from uncal.checking.finding import Finding
from uncal.checking.geometry import REPAIRED

LONGEST_LAG = 2
"""Frames by which scans are shifted against images."""

_BETTER = 1.1
_MAJORITY = 0.75
_SIGNIFICANT = 3.0


def agreements(views: Sequence[View]) -> NDArray[np.float64]:
    """(images, scans) agreement of every image with every scan."""
    n = len(views)
    table = np.full((n, n), np.nan)
    for i, image in enumerate(views):
        for j, scan in enumerate(views):
            table[i, j] = float(agreement(_paired(image, scan), image.T[None])[0])
    return np.asarray(np.nan_to_num(table))


def of_pairs(drive: str, runs: Sequence[Sequence[View]]) -> list[Finding]:
    """Scans that fit another image better than their own, in stretches of consecutive frames.

    Said only where the other pairs show a peak at the extrinsic: with a wrong one, any pair is as
    good as its own.
    """
    views = [view for run in runs for view in run]
    table, n = agreements(views), len(views)
    ends = np.cumsum([len(run) for run in runs])
    blocks = [slice(end - len(run), end) for end, run in zip(ends, runs, strict=True)]
    for lag in sorted(set(range(-LONGEST_LAG, LONGEST_LAG + 1)) - {0}, key=abs):
        gains = np.concatenate([_gain(table[block, block], lag) for block in blocks])
        pairs = [
            (i, i + lag)
            for block in blocks
            for i in range(block.start, block.stop)
            if block.start <= i + lag < block.stop
        ]
        if len(gains) >= 3 and _clear(gains, np.diag(table)) and _has_peak(views, pairs):
            return [_said(drive, f"images fit the scan {lag:+d} better than their own in "
                          f"{int((gains > 0).sum())} of {len(gains)} frames")]  # fmt: skip
    rows, columns = linear_sum_assignment(-table)
    moved = [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if i != j]
    own = float(np.trace(table))
    gain = float(table[rows, columns].sum()) - own
    if (
        n >= 4
        and len(moved) >= 0.5 * n
        and gain > 0.25 * max(own, 1e-6)
        and _has_peak(views, moved)
    ):
        return [_said(drive, f"{len(moved)} of {n} images fit another scan of the drive better")]
    return []


def _paired(image: View, scan: View) -> View:
    return image._replace(edges=scan.edges, along=scan.along, weights=scan.weights)


def _has_peak(views: Sequence[View], pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether the extrinsic is a peak with these pairs of an image and a scan."""
    paired = [_paired(views[i], views[j]) for i, j in pairs]
    return peak_height(paired, views[0].T) >= REPAIRED


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
