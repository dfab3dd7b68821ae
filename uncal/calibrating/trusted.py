"""Trusted frames, decalibrated artificially, calibrate the intervals of trained weights."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import lightning
from omegaconf import DictConfig
from torch import Tensor

from uncal.calibrating.guarantee import choose_interval, possible_levels, summary
from uncal.calibrating.walk import batches_of_one_walk
from uncal.errors import ConfigurationError, FrameError, RecordingError
from uncal.inference.split_passes import predict_batches, predict_split
from uncal.models.split_prediction import SplitPrediction
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.reference_windows import ReferenceWindows
from uncal.monitor.references import INSIDE
from uncal.monitor.settings import MonitorSettings
from uncal.recordings.frame import FrameId, Recording
from uncal.recordings.static_transform import StaticTransform
from uncal.reporting.layout import replaced_whole
from uncal.runs.assembly import RECIPE, build_data, build_module, build_trainer
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.runs.evaluation_settings import with_settings_of
from uncal.settings.check import refuse_values
from uncal.weights.shipped import save_shipped

log = logging.getLogger(__name__)

ALL_CALIBRATE: tuple[float, float, float, float] = (0.01, 0.01, 0.97, 0.01)
"""Shares of the trusted recordings."""

_SPLIT = "uncertainty_calibration"


def calibrate(config: DictConfig, words: list[str], weights: Path, out: Path) -> list[str]:
    """Fit the calibrator, make the monitor's references; write one file and ROS files. Gives lines.

    Raises:
        ConfigurationError: no level is possible with so few frames.
    """
    asked = {word.lstrip("+~").split("=", 1)[0] for word in words}
    if not any(key in ("mcd", "mcd.masks") for key in asked):
        config.mcd.masks = "fixed"
        words.append("mcd.masks=fixed")
    run = with_settings_of(config, read_recipe(weights), [*words, "dataset=given"], RECIPE)
    if not any(key.startswith("split") for key in asked):
        run.split.fractions, run.split.by = list(ALL_CALIBRATE), "frame"
    refuse_values(run, None)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    data = build_data(run)
    frames = data.named(_SPLIT)
    drives = len({(frame.rig, frame.drive) for frame in frames})
    lines = [] if "interval" in asked else [choose_interval(run.interval, drives)]
    by_drive = run.interval.calibrator._target_.endswith("HierarchicalCalibrator")
    levels = list(run.interval.levels)
    run.interval.levels = possible_levels(levels, drives if by_drive else len(frames))
    if not run.interval.levels:
        raise ConfigurationError(
            f"{len(frames)} frames of {drives} drive(s) are too few for any of "
            f"interval.levels={levels}: give more frames (100 to 500), or lower levels"
        )
    module, trainer = build_module(run), build_trainer(run)
    load_weights(module, weights, calibrated=False)
    module.eval()
    windows = None
    if config.references:
        settings = MonitorSettings.shipped()
        reader = EvidenceReader(module, module.device, settings.seed)
        windows = ReferenceWindows(reader, settings)
        batches = batches_of_one_walk(data, _SPLIT, windows.take, "MC dropout and references")
        scores = predict_batches(trainer, module, data, _SPLIT, batches)
    else:
        scores = predict_split(trainer, module, data, _SPLIT)
    module.fit_calibrator(scores, frames)
    lines += summary(module, scores, frames, levels)
    inside: dict[str, Tensor] = {}
    if windows is not None:
        inside, said = _references(windows, settings.level, out, str(config.recordings))
        lines.append(said)
    with replaced_whole(out) as partial:
        save_shipped(module.state_dict(), module.recipe, partial, inside)
    written = [out]
    transform = _transform(config, data.recording, frames, scores)
    if transform is not None:
        written += transform.write(out.with_suffix(""))
    if data.skipped:
        lines.append(f"{len(data.skipped)} frames skipped; see above.")
    return [*lines, *map(str, written)]


def _references(
    windows: ReferenceWindows, level: float, out: Path, label: str
) -> tuple[dict[str, Tensor], str]:
    """What of the monitor's references goes into the file of weights, and a sentence on them."""
    try:
        references = windows.references(label)
    except RecordingError as error:
        return {}, f"No references for the monitor, which watches single frames then: {error}"
    for exchangeable in ("drive", "window"):
        try:
            references.check_level(level, exchangeable)
        except ConfigurationError as error:
            reason = str(error)
            continue
        hint = "" if exchangeable == "drive" else " exchangeable=window"
        return {INSIDE: references.packed()}, (
            f"The monitor's references: {len(references.drives)} windows. python -m "
            f"uncal.monitor weights={out}{hint} source=…"
        )
    return {}, f"No references for the monitor, which watches single frames then: {reason}"


def _transform(
    config: DictConfig, recording: Recording, frames: Sequence[FrameId], scores: SplitPrediction
) -> StaticTransform | None:
    """The trusted extrinsic; None where the recordings have several."""
    known = []
    for frame_id in {frame.rig: frame for frame in frames}.values():
        try:
            known.append(recording.load(frame_id).T_cam_lidar)
        except FrameError:
            continue
    if len(known) != 1:
        log.info("%d rigs: no static transform is written.", len(known))
        return None
    error = (scores.mean - scores.target).double()
    covariance = error.T @ error / len(error)
    about = (
        f"Trusted extrinsic of {config.recordings}; covariance of the error of an estimate from "
        f"one frame, over {len(error)} frames decalibrated artificially."
    )
    return StaticTransform(
        known[0], covariance.numpy(), about, config.frame.camera, config.frame.lidar
    )
