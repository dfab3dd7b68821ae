"""Run folders as a test leaves them, from predictions made up."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.models.split_prediction import ControlPrediction
from uncal.recordings.frame import FrameId
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.measure import measure
from uncal.reporting.report import write_report
from uncal.uncertainty import ConformalCalibrator, GaussianIntervals

LABEL = "simulated street-scene"
LEVELS = (0.9, 0.95, 0.99)

MakeRun = Callable[..., Path]


def predictions(n: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, σ that is too small by half, and target: ±10 cm, ±1°."""
    generator = torch.Generator().manual_seed(seed)
    reach = torch.tensor([0.1] * 3 + [math.radians(1)] * 3)
    target = (2 * torch.rand(n, 6, generator=generator) - 1) * reach
    std = reach * (0.1 + 0.2 * torch.rand(n, 6, generator=generator))
    return target + 2 * std * torch.randn(n, 6, generator=generator), std, target


def control(mean: Tensor, target: Tensor) -> ControlPrediction:
    """With its own image as the mean of the passes; with another one three times as wrong."""
    n = len(target)
    frames = tuple(FrameId(f"rig_{i // 10}", "drive", i) for i in range(n))
    return ControlPrediction(torch.arange(n), frames, mean, target + 3 * (mean - target), target)


def make_run(
    folder: Path, *, seed: int = 0, gaussian: bool = False, bare: bool = False, label: str = LABEL
) -> Path:
    """A finished run; a bare one has no run.json, control.csv and predictions.csv."""
    kind = GaussianIntervals if gaussian else ConformalCalibrator
    calibrator = kind(DOF_NAMES).fit(*predictions(120, seed=seed + 100))
    mean, std, target = predictions(40, seed=seed)
    results = measure(
        Evaluation(mean, std, target, calibrator),
        LEVELS,
        control=None if bare else control(mean, target),
        frames=None if bare else [f"rig_0/drive/{i:010d}" for i in range(len(target))],
    )
    write_report(folder, results, label=label)
    if not bare:
        target_class = f"uncal.uncertainty.{kind.__name__}"
        record = {
            "command": f"python -m uncal.train seed={seed}",
            "label": label,
            "seed": seed,
            "commit": "abc1234",
            "version": "0.1.0",
            "settings": {
                "seed": seed,
                "model": {"name": "unical"},
                "dataset": {"split_by": "rig"},
                "split": {"by": "${dataset.split_by}"},
                "mcd": {"passes": 25},
                "interval": {"calibrator": {"_target_": target_class}},
            },
            "weights": {
                "fingerprint": "0123456789abcdef",
                "reused": gaussian,
                "path": "outputs/trained/best.ckpt",
                "training_seconds": 400.2,
            },
            "passes": {"test": "computed"},
        }
        (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def make() -> MakeRun:
    """:func:`make_run`."""
    return make_run
