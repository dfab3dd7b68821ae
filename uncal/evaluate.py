"""The table of trained weights: ``python -m uncal.evaluate weights=unical``, or ``ckpt=…``."""

from __future__ import annotations

from pathlib import Path

import hydra
from omegaconf import DictConfig

from uncal.errors import ConfigurationError
from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.guard import task_words
from uncal.settings.help_page import show_help

CALIBRATION = ("model", "interval", "mcd", "window", "split", "decalibration", "seed")
"""Settings that a calibration belongs to."""


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="evaluate")
@exits_on_error
def main(config: DictConfig) -> float:
    """Test weights with the settings that they were trained with, or as asked.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration.
    """
    # Here and not above: they take seconds, which --help has no use for.
    import lightning

    from uncal.runs.assembly import RECIPE, build_data, build_module, build_trainer, say_simulated
    from uncal.runs.checkpoint import read_recipe
    from uncal.runs.evaluation_settings import with_settings_of
    from uncal.runs.weights_to_report import finished_earlier, make_record, weights_to_report
    from uncal.settings.check import check_settings, refuse_values
    from uncal.system.memory import keep_freed_memory
    from uncal.weights.digest import digest_of_file
    from uncal.weights.load_or_train import CHECKPOINT, Weights

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    path = chosen_weights(config.weights, config.ckpt)
    recipe = read_recipe(path)
    run = with_settings_of(config, recipe, task_words(), RECIPE)
    refuse_values(run, None)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    say_simulated(run)
    module = build_module(run)
    trainer = build_trainer(run)
    data = build_data(run)
    weights = Weights(path, "", reused=True, trained=None)
    record = make_record(
        "uncal.evaluate", run, module, trainer, {"ckpt": digest_of_file(weights.path)}
    )
    earlier = finished_earlier(record, retrain=False)
    if earlier is not None:
        return earlier
    record.begin()
    other_data = run.dataset.name != recipe.dataset.name
    calibrated = not other_data and all(run[key] == recipe[key] for key in CALIBRATION)
    if not run.refit and not calibrated:
        calibrated = True
        module.run.notes.append(
            f"Intervals as calibrated on {recipe.dataset.label} data (refit=false): nothing "
            "guarantees their coverage elsewhere."
        )
    parts = (run, module, trainer, data, weights, record)
    return weights_to_report(*parts, calibrated=calibrated, checkpoint=CHECKPOINT)


def chosen_weights(weights: str | None, ckpt: str | None) -> Path:
    """The file that the user means.

    Raises:
        ConfigurationError: none, both, or no such file.
    """
    from uncal.weights.shipped import find_weights, shipped_names

    if (weights is None) == (ckpt is None):
        raise ConfigurationError(
            f"weights={weights}, ckpt={ckpt}: give one of them; shipped weights are "
            f"{', '.join(shipped_names()) or 'none'}"
        )
    return Path(str(ckpt)) if weights is None else find_weights(weights)


if __name__ == "__main__":
    show_help("hydra/evaluate.yaml")
    quote_arguments()
    main()
