"""Intervals for a user's own rig: ``python -m uncal.calibrate weights=unical recordings=ROOT``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.help_page import show_help

if TYPE_CHECKING:
    from uncal.models.module import CalibrationModule
    from uncal.models.split_prediction import SplitPrediction

log = logging.getLogger(__name__)

ALL_CALIBRATE: tuple[float, float, float, float] = (0.01, 0.01, 0.97, 0.01)
"""Shares of the trusted recordings."""


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="calibrate")
@exits_on_error
def main(config: DictConfig) -> None:
    """Decalibrate trusted frames, fit the calibrator on them, and write one file.

    Args:
        config: conf/calibrate.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    import lightning

    from uncal.errors import ConfigurationError
    from uncal.evaluate import chosen_weights
    from uncal.inference.split_passes import predict_split
    from uncal.runs.assembly import RECIPE, build_data, build_module, build_trainer
    from uncal.runs.checkpoint import load_weights, read_recipe
    from uncal.runs.evaluation_settings import with_settings_of
    from uncal.settings.check import check_settings, refuse_values
    from uncal.weights.shipped import save_shipped

    quiet_libraries()
    check_settings(config)
    out = Path(config.out)
    if out.suffix != ".safetensors":
        raise ConfigurationError(f"out={out}: expected a name that ends in .safetensors")
    path = chosen_weights(config.weights, config.ckpt)
    words = list(HydraConfig.get().overrides.task)
    config.dataset.root = config.recordings
    if not any(word.startswith(("mcd.masks=", "mcd=")) for word in words):
        config.mcd.masks = "fixed"
        words.append("mcd.masks=fixed")
    run = with_settings_of(config, read_recipe(path), [*words, "dataset=given"], RECIPE)
    if not any(word.startswith("split") for word in words):
        run.split.fractions, run.split.by = list(ALL_CALIBRATE), "frame"
    refuse_values(run, None)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    module, trainer, data = build_module(run), build_trainer(run), build_data(run)
    load_weights(module, path, calibrated=False)
    module.eval()
    scores = predict_split(trainer, module, data, "uncertainty_calibration")
    frames = data.named("uncertainty_calibration")
    module.fit_calibrator(scores, frames)
    save_shipped(module.state_dict(), module.recipe, out)
    for line in summary(module, scores, scores.groups(frames, "drive"), list(run.interval.levels)):
        log.info("%s", line)
    log.info("%s", out)


def summary(
    module: CalibrationModule,
    scores: SplitPrediction,
    drives: Sequence[str],
    levels: Sequence[float],
) -> list[str]:
    """What the calibration can guarantee, and what more frames would buy.

    Args:
        module: calibrated.
        scores: predictions that it was calibrated with.
        drives: of each of them.
        levels: coverage levels.

    Returns:
        Lines of text.
    """
    from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
    from uncal.uncertainty.conformal.coverage_law import coverage_band
    from uncal.uncertainty.conformal.quantile import miscoverage, samples_needed

    m = len(scores.index)
    lines = [f"{m} frames of {len(set(drives))} drive(s)."]
    for level in levels:
        alpha = miscoverage(level)
        if m < samples_needed(alpha):
            lines.append(f"{level:.0%}: not possible; it takes {samples_needed(alpha)} frames.")
            continue
        bands = [(n, coverage_band(10_000, n, alpha, 0.9)) for n in (m, 4 * m)]
        (_, now), (more, then) = bands
        lines.append(
            f"{level:.0%}: in 9 of 10 calibrations the coverage is {100 * now[0]:.1f}-"
            f"{100 * now[1]:.1f}% (with {more} frames {100 * then[0]:.1f}-{100 * then[1]:.1f}%)."
        )
        if module.calibrator.needs_groups:
            continue
        found = module.calibrator.predict(scores.mean, scores.std, level, bounds=scores.bounds)
        half = (found.upper - found.lower).mean(0) / 2
        widths = zip(DOF_NAMES, half.tolist(), DOF_SCALE, DOF_UNITS, strict=True)
        lines.append("  ± " + ", ".join(f"{n} {w * s:.2f} {u}" for n, w, s, u in widths))
    lines.append(
        "This holds for frames exchangeable with these. Frames of one drive are dependent: "
        + (
            "with one drive nothing is known of others."
            if len(set(drives)) < 2
            else "for a guarantee on new drives use interval=hierarchical."
        )
    )
    return lines


if __name__ == "__main__":
    show_help("calibrate.yaml")
    quote_arguments()
    main()
