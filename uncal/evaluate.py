"""The table of a trained checkpoint again: ``python -m uncal.evaluate ckpt=…/best.ckpt``."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import cast

import hydra
import lightning
from omegaconf import DictConfig, OmegaConf

from uncal.assembly import build_data, build_module, build_trainer
from uncal.callbacks.report import Report
from uncal.checkpoint import load_weights, read_recipe
from uncal.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.memory import keep_freed_memory
from uncal.runs import finished_earlier, keep_results, make_record, remember_passes
from uncal.weights.digest import digest_of_file
from uncal.weights.ingredients import data_ingredients
from uncal.weights.obtain import Weights

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="evaluate")
@exits_on_error
def main(config: DictConfig) -> float:
    """Test a checkpoint with the settings it was trained with.

    Args:
        config: conf/evaluate.yaml with the command line's overrides.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration.
    """
    keep_freed_memory()
    quiet_libraries()
    recipe = read_recipe(Path(config.ckpt))
    OmegaConf.set_struct(config, False)  # the recipe brings keys of its own
    run = OmegaConf.merge(config, recipe)
    if config.dataset.root is not None:
        run.dataset.root = run.dataset.recording.root = config.dataset.root
    if config.dataset.workers is not None:
        run.dataset.loader.workers = config.dataset.workers
    run = cast(DictConfig, run)
    recipe.mcd.setdefault("seed", recipe.seed)  # checkpoints of version 0.1.0 have none
    asked = {key: value for key, value in config.mcd.items() if value is not None}
    run.mcd = OmegaConf.merge(recipe.mcd, asked)
    if config.get("interval") is None:
        run.interval = recipe.interval
    else:
        run.interval = config.interval
        log.info("intervals by %s", run.interval.calibrator._target_)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    data = build_data(run)
    module = build_module(run)
    trainer = build_trainer(run)
    weights = Weights(Path(config.ckpt), "", reused=True, trained=None)
    record = make_record(
        "uncal.evaluate", run, module, trainer, {"ckpt": digest_of_file(weights.path)}
    )
    earlier = finished_earlier(record, retrain=False)
    if earlier is not None:
        return earlier
    record.begin()
    same = run.interval == recipe.interval and run.mcd.seed == recipe.mcd.seed
    load_weights(module, weights.path, calibrated=same)
    module.provenance.append(weights.sentence())
    if run.store is not None:
        remember_passes(run, module, trainer, data_ingredients(run, data))
    trainer.test(module, datamodule=data, verbose=False)
    if trainer.is_global_zero:
        keep_results(record, trainer, module, weights)
    return Report.of(trainer).results.summary.mean_ratio


if __name__ == "__main__":
    main()
