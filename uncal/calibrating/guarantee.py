"""Which interval method trusted recordings allow, what it guarantees, and what more would buy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf, open_dict

from uncal.geometry.transforms import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction
from uncal.recordings.frame import FrameId
from uncal.settings.configuration import CONFIG_DIR
from uncal.uncertainty.conformal.quantile import (
    conformal_rank,
    coverage_band,
    miscoverage,
    samples_needed,
)


def choose_interval(interval: DictConfig, drives: int) -> str:
    """Take the hierarchical method where there are drives enough; returns a sentence why or not."""
    needed = samples_needed(miscoverage(min(interval.levels)))
    percent = f"{min(interval.levels):.0%}"
    if drives < 2:
        return (
            "interval=conformal: the frames are of one drive, and nothing is known of others. "
            f"With {needed} drives or more the guarantee would be for new drives, at {percent}."
        )
    if drives < needed:
        return (
            f"interval=conformal: it holds for frames of drives like these {drives}. A guarantee "
            f"for new drives (interval=hierarchical) takes {needed} drives at {percent}."
        )
    hierarchical = OmegaConf.load(Path(CONFIG_DIR) / "interval" / "hierarchical.yaml")
    with open_dict(interval):
        interval.calibrator, interval.groups = hierarchical.calibrator, "drive"
    return (
        f"interval=hierarchical: frames of one drive are alike, so that the {drives} drives count "
        "and not the frames, and the guarantee is for a new drive."
    )


def possible_levels(levels: Sequence[float], units: int) -> list[float]:
    """Levels with finite intervals, given the frames, or the drives of the hierarchical method."""
    return [level for level in levels if samples_needed(miscoverage(level)) <= units]


def summary(
    module: CalibrationModule,
    scores: SplitPrediction,
    frames: Sequence[FrameId],
    levels: Sequence[float],
) -> list[str]:
    """Lines that say what the calibration of a module with the scores of some frames guarantees."""
    drives = len(set(scores.groups(frames, "drive")))
    by_drive = module.calibrator.kind == "hierarchical"
    m, what = (drives, "drives") if by_drive else (len(scores.index), "frames")
    lines = [f"{len(scores.index)} frames of {drives} drive(s)."]
    for level in levels:
        alpha = miscoverage(level)
        if m < samples_needed(alpha):
            lines.append(f"{level:.0%}: not possible; it takes {samples_needed(alpha)} {what}.")
            continue
        now, then = (coverage_band(10_000, n, alpha, 0.9) for n in (m, 4 * m))
        lines.append(
            f"{level:.0%}: guaranteed on average; in 9 of 10 calibrations with {m} {what} the "
            f"coverage is {_percent(now)}, with {4 * m} {what} {_percent(then)}."
        )
        # A larger set needs a rank less far above the level.
        now_wide, then_wide = (_widths(module, scores, frames, level, n) for n in (None, 4 * m))
        lines.append(f"  now {now_wide}")
        if not by_drive and then_wide != now_wide:
            lines.append(f"  with {4 * m} {what} about {then_wide}")
    lines.append("This holds for decalibrations within the range, of frames or drives like these.")
    return lines


def _percent(band: tuple[float, float]) -> str:
    return f"{100 * band[0]:.1f}-{100 * band[1]:.1f} %"


def _widths(
    module: CalibrationModule,
    scores: SplitPrediction,
    frames: Sequence[FrameId],
    level: float,
    m: int | None = None,
) -> str:
    """Mean half-widths, as calibrated or as they would be with m samples of the same law."""
    if m is not None:
        n, share = len(scores.index), conformal_rank(m, miscoverage(level)) / m
        # At this level the rank among n is that share of n.
        level = min(level, share * n / (n + 1))
    found = module.intervals(scores, frames, level)
    half = ((found.upper - found.lower).mean(0) / 2).tolist()
    parts = zip(DOF_NAMES, half, DOF_SCALE, DOF_UNITS, strict=True)
    return "± " + ", ".join(f"{n} {w * s:.2f} {u}" for n, w, s, u in parts)
