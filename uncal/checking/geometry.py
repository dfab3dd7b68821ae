"""Which fault the edges of sweeps and images show: each repair against what is declared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.checking.evidence import View, agreement, peak_height
from uncal.checking.finding import Finding
from uncal.checking.hypotheses import Hypothesis, degrees_read_as_radians, hypotheses

SUPPORTED = 3.0
"""Height of its peak from which the edges support what is declared."""

REPAIRED = 3.5
"""Height that a repair must have."""

BETTER = 1.15
"""A repair's edges must lie on image edges so many times as strong."""

MAJORITY = 0.75
"""Share of the frames in which a repair must be better."""

SIGNIFICANT = 3.0
"""Mean of the gains over the frames by the standard error of that mean."""

_SHORTLIST = 6
_EQUAL = 0.9
"""Repairs that come so close to the best one are told apart by which mistake is usual."""

_FAR_M = 500.0
"""No LiDAR of a vehicle has half of its returns from beyond."""

_BRIGHTEST = 1.5
"""Reflectances are 0 to 1; a driver may calibrate a little beyond."""

_USUAL = (
    *("inverted", "camera frame", "mirrored", "millimetres"),
    *("degrees", "resolution", "axes", "distortion"),
)


class Judgement(NamedTuple):
    """What the edges say of a drive."""

    support: float  # height of the declared extrinsic's peak; NaN where too few edges are seen
    repair: Hypothesis | None  # the repair that fits; None where nothing needs one, or none fits


def judge(views: Sequence[View]) -> Judgement:
    """Compare what is declared with its repairs; one is named only where it is clearly better."""
    first = views[0]
    declared = Hypothesis("", "", "", first.T)
    support = peak_height(views, declared.T)
    repair = _best(views, declared, support, hypotheses(first))
    if repair is None and not support >= SUPPORTED:
        repair = _best(views, declared, support, degrees_read_as_radians(views))
    return Judgement(support, repair)


def finding(drive: str, judgement: Judgement, in_view: bool) -> list[Finding]:
    """The judgement in words; ``in_view``: any point is in the image, as declared."""
    support, repair = judgement
    declared = f"{support:.1f} σ"
    if np.isnan(support):
        declared = "too few edges in the image" if in_view else "no point is in the image"
    if repair is not None:
        return [
            Finding(
                repair.kind,
                drive,
                f"{repair.seen} (as declared: {declared})",
                "edges of the sweep on edges of the image as declared",
                repair.remedy,
            )
        ]
    if support >= SUPPORTED:
        return []
    return [
        Finding(
            "unconfirmed",
            drive,
            f"turned by 2° to 5°, the extrinsic fits about as well ({declared})",
            f"a peak of at least {SUPPORTED:g} σ at the extrinsic",
            "look at the overlay: the extrinsic may be degrees off, or the scenes have few edges",
            error=not in_view,
        )
    ]


def of_units(drive: str, points: NDArray[np.float32]) -> Finding | None:
    """Points in millimetres, by their ranges alone: a projection does not tell."""
    usual = float(np.median(np.linalg.norm(points[:, :3], axis=1)))
    if usual < _FAR_M:
        return None
    return Finding(
        "millimetres",
        drive,
        f"half of the points are further than {usual:.0f} from the LiDAR",
        "metres: half of the points of a street are nearer than about 15",
        "divide x, y, z by 1000",
    )


def of_reflectance(drive: str, points: NDArray[np.float32]) -> Finding | None:
    """Reflectances in another unit, bytes or 16 bits for instance."""
    largest = float(points[:, 3].max())
    if largest <= _BRIGHTEST:
        return None
    return Finding(
        "reflectance",
        drive,
        f"reflectances up to {largest:.0f}",
        "0 to 1",
        "divide them by what stands for full reflectance (lidars.NAME.brightest in rig.yaml)",
    )


def _best(
    views: Sequence[View],
    declared: Hypothesis,
    support: float,
    repairs: Sequence[Hypothesis],
) -> Hypothesis | None:
    if not repairs:
        return None
    now = _values(views, declared)
    table = np.stack([_values(views, repair) for repair in repairs])
    seen = np.isfinite(table).mean(1) > 0.5
    mean = np.where(seen, np.nanmean(np.where(seen[:, None], table, 0.0), 1), -np.inf)
    shortlist = [i for i in np.argsort(-mean)[:_SHORTLIST] if np.isfinite(mean[i])]
    good: list[tuple[float, Hypothesis]] = []
    for i in shortlist:
        if not _beats(table[i], now):
            continue
        height = peak_height(views, repairs[i].T, repairs[i].K, repairs[i].k1)
        if height >= max(REPAIRED, 0.0 if np.isnan(support) else support):
            good.append((float(mean[i]), repairs[i]))
    if not good:
        return None
    top = max(value for value, _ in good)
    equal = [repair for value, repair in good if value >= _EQUAL * top]
    return min(equal, key=lambda repair: _USUAL.index(repair.kind))


def _beats(repaired: NDArray[np.float64], declared: NDArray[np.float64]) -> bool:
    """Whether a repair is better in nearly all frames, by much, and not by chance."""
    good = np.isfinite(repaired)
    now = np.where(np.isfinite(declared), declared, 0.0)[good]
    gain = repaired[good] - now
    error = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else 0.0
    return bool(
        repaired[good].mean() > BETTER * max(float(now.mean()), 0.0)
        and (gain > 0).mean() >= MAJORITY
        and gain.mean() > SIGNIFICANT * error
    )


def _values(views: Sequence[View], hypothesis: Hypothesis) -> NDArray[np.float64]:
    T = hypothesis.T[None]
    found = [agreement(view, T, hypothesis.K, hypothesis.k1)[0] for view in views]
    return torch.stack(found).numpy().astype(np.float64)
