"""Which settings an evaluation takes from the command line, and which from the weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from omegaconf import DictConfig, OmegaConf, open_dict

OWN: tuple[str, ...] = ("weights", "ckpt", "refit", "store", "trainer", "callbacks", "logger")
"""Top-level keys that an evaluation has for itself."""

NOTHING_TRAINS: tuple[float, float, float, float] = (0.01, 0.01, 0.58, 0.40)
"""Shares of new recordings: all that can be calibrates the uncertainty and tests."""

ALL_TEST: tuple[float, float, float, float] = (0.01, 0.01, 0.01, 0.97)
"""The same with ``refit=false``."""


def with_settings_of(
    config: DictConfig, recipe: DictConfig, overrides: Sequence[str], kept: Sequence[str]
) -> DictConfig:
    """The settings that weights were trained with, but for what the user asks for.

    A group chosen on the command line (``dataset=kitti``) replaces the weights' group whole; a key
    (``mcd.passes=50``) replaces that key. New recordings bring their own split, by default with
    next to nothing for the training that they do not do, and their images are brought to the focal
    length that the weights know.
    """
    run = cast(DictConfig, OmegaConf.create(OmegaConf.to_container(config)))
    asked = [word.lstrip("+~").split("=", 1)[0].split("@")[0] for word in overrides]
    groups = {key.split("/")[0] for key in asked if "/" in key or key in kept}
    keys = [key for key in asked if "." in key and key.split(".")[0] in kept]
    other_data = "dataset" in groups
    with open_dict(run):
        for name in kept:
            if name in groups or (name == "split" and other_data):
                continue
            run[name] = recipe[name]
        for key in keys:
            if key.split(".")[0] not in groups:
                OmegaConf.update(run, key, OmegaConf.select(config, key), force_add=True)
        if other_data:
            run.dataset.focal_px = focal_of(recipe)
            if "dataset.image_size" not in asked:
                run.dataset.image_size = None
            if "split.fractions" not in asked and "split" not in groups:
                kept_as_it_is = config.get("refit", True) is False
                run.split.fractions = list(ALL_TEST if kept_as_it_is else NOTHING_TRAINS)
        elif "dataset.root" in asked and "recording" in run.dataset:
            run.dataset.recording.root = run.dataset.root
        if "dataset.loader.workers" in asked and not other_data:
            run.dataset.loader.workers = config.dataset.loader.workers
    return run


def focal_of(recipe: DictConfig) -> float | None:
    """Focal length of the images that weights were trained on, pixels; None if it is not known."""
    known = recipe.dataset.get("focal_px")
    if known is None:
        known = OmegaConf.select(recipe, "dataset.simulation.camera.focal_px")
    return None if known is None else float(known)
