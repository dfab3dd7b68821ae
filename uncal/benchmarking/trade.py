"""What dropout is worth by where it stands: interval score and coverage against time."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import cast

import lightning
import pandas as pd
import torch

from uncal.benchmarking.latency import placements, seconds
from uncal.errors import ConfigurationError, RecordingError
from uncal.geometry import DOF_SCALE
from uncal.inference.split_passes import predict_split
from uncal.metrics.functional import interval_score, mpiw, picp
from uncal.models.answer import Estimator
from uncal.runs.assembly import build_data, build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.uncertainty.conformal.quantile import miscoverage
from uncal.uncertainty.dropout.mc_dropout import MCDropout


def measure_trade(
    ckpt: Path, data_root: str | None, rounds: int, device: torch.device
) -> tuple[pd.DataFrame, str]:
    """Calibrate and test the same weights with dropout in fewer and fewer layers.

    Returns:
        What the data are, behind a row per placement and level: dropout (where it is on), level
        (nominal coverage, percent), milliseconds (median for one frame), ratio (median of that
        time / one deterministic pass beside it), is_translation and is_rotation (interval score,
        mean over X, Y, Z, cm, and over roll, pitch, yaw, degrees), mpiw_translation and
        mpiw_rotation (interval width), picp (empirical coverage, mean over the DoF, percent),
        picp_low and picp_high (of the six), mae_translation and mae_rotation (mean absolute error
        of the mean of the passes).

    Raises:
        UncalError: the checkpoint or its recordings cannot be used.
    """
    run = read_recipe(ckpt)
    if data_root is not None:
        run.dataset.root = run.dataset.recording.root = data_root
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    data, module = build_data(run), build_module(run)
    load_weights(module, ckpt, calibrated=True)
    if not module.learns:
        raise ConfigurationError(
            f"ckpt={ckpt}: model={run.model.name} has no dropout, whose placement could be measured"
        )
    module.to(device).eval()
    trainer = lightning.Trainer(
        accelerator="gpu" if device.type == "cuda" else "cpu",
        devices=1,
        logger=False,
        enable_progress_bar=False,
    )
    scale = torch.tensor(DOF_SCALE)
    batch = next(iter(data.loader_of("test", most=1)))
    one = data.on_after_batch_transfer(batch.to(device), 0)
    if one is None:
        (frame, reason), *_ = data.skipped.items()
        raise RecordingError(f"{frame}, which passes are timed on, cannot be read: {reason}")
    estimator = cast(Estimator, module.estimator)
    with torch.no_grad():
        question = estimator.question(one)
    rows = []
    for where, layers in placements(estimator.repeated).items():
        module.engine = MCDropout(
            estimator.repeated,
            run.mcd.passes,
            run.mcd.chunk,
            select=layers,
            masks=module.masks,
            keep_samples=True,
        )
        milliseconds, ratio = _time(module.engine, estimator.repeated, question.arguments, rounds)
        split = "uncertainty_calibration"
        module.fit_calibrator(predict_split(trainer, module, data, split), data.named(split))
        test = predict_split(trainer, module, data, "test")
        error = ((test.mean - test.target).abs().mean(0) * scale).tolist()
        for level in map(float, run.interval.levels):
            made = module.intervals(test, data.named("test"), level)
            alpha = float(miscoverage(level))
            score = interval_score(made.lower, made.upper, test.target, alpha) * scale
            width = mpiw(made.lower, made.upper) * scale
            covered = 100.0 * picp(made.lower, made.upper, test.target)
            row = {
                "dropout": where,
                "level": 100 * level,
                "milliseconds": milliseconds,
                "ratio": ratio,
                "is_translation": score[:3].mean().item(),
                "is_rotation": score[3:].mean().item(),
                "mpiw_translation": width[:3].mean().item(),
                "mpiw_rotation": width[3:].mean().item(),
                "picp": covered.mean().item(),
                "picp_low": covered.min().item(),
                "picp_high": covered.max().item(),
                "mae_translation": sum(error[:3]) / 3,
                "mae_rotation": sum(error[3:]) / 3,
            }
            rows.append(row)
    return pd.DataFrame(rows), str(run.dataset.label)


def _time(
    engine: MCDropout, network: torch.nn.Module, inputs: tuple[object, ...], rounds: int
) -> tuple[float, float]:
    """Milliseconds of the passes for one frame, and their ratio to one deterministic pass."""
    device = next(network.parameters()).device
    with torch.inference_mode():
        times = [
            (
                seconds(lambda: network(*inputs), device),
                seconds(lambda: engine(*inputs, seed=0), device),
            )
            for _ in range(3 * rounds + 1)
        ]
    del times[0]  # it warms up
    ratios = (passes / one for one, passes in times)
    return 1e3 * statistics.median(passes for _, passes in times), statistics.median(ratios)
