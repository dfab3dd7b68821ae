"""Bounds of the settings, by key; what has none here must be of the kind of the shipped value.

Groups that check themselves (the simulation, the decalibration) are not repeated here. A star
stands for anything; of several entries the first that matches counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

from uncal.settings.rules import FLAG, TEXT, Rule, either, listed, number, words

DOF_NAMES = ("X", "Y", "Z", "Roll", "Pitch", "Yaw")
SEED = number(0, 2**32 - 1, whole=True)
RATE = number(0, 1, below=True)
SHARE = number(0, 1)
LEVEL = number(0, 1, above=True, below=True)
COUNT = number(1, 1_000_000, whole=True)
NAMES = either(listed(TEXT), TEXT, None)
PATH = either(TEXT, None)
LEVELS = listed(LEVEL, distinct=True)
ROWS = either(COUNT, words("auto"), None)

BOUNDS: Mapping[str, Rule] = {
    "*seed": SEED,
    "ckpt": PATH,
    "store": PATH,
    "weights": PATH,
    "model.weights": PATH,
    "root": TEXT,
    "workers": either(number(1, 256, whole=True), None),
    "device": words("auto", "cpu", "cuda"),
    "data_root": PATH,
    "passes": number(1, 10_000, whole=True),
    "rounds": number(1, 10_000, whole=True),
    "cases.*.size": listed(number(32, 4096, whole=True), 2),
    "cases.*.batches": listed(COUNT),
    "compile": either(words("auto"), FLAG),
    "decalibration.rotation_deg": number(0, 45, above=True),
    "decalibration.translation_cm": number(0, 1000, above=True),
    "guess.rotation_deg": number(0, 10, above=True),
    "guess.translation_cm": number(0, 100, above=True),
    "guess.frames": COUNT,
    "recordings": TEXT,
    "augmentation.mirror": SHARE,
    "augmentation.brightness": RATE,
    "augmentation.contrast": SHARE,
    "window.frames": number(1, 1000, whole=True),
    "mcd.passes": number(1, 10_000, whole=True),
    "mcd.strategy": words("auto", "shared", "batch", "loop"),
    "mcd.masks": words("random", "fixed"),
    "mcd.chunk": ROWS,
    "mcd.layers": either(listed(TEXT), None),
    "mcd.insert.after": listed(TEXT),
    "mcd.insert.exclude": listed(TEXT),
    "mcd.insert.p": LEVEL,
    "interval.levels": LEVELS,
    "levels": either(LEVELS, None),
    "image_size": listed(number(32, 4096, whole=True), 2),
    "interval.sigma_floor": SHARE,
    "interval.quantile_levels": listed(LEVEL, 2, rising=True),
    "interval.groups": words("rig", "drive"),
    "interval.calibrator.repeats": number(1, 10_000, whole=True),
    "source": TEXT,
    "drive": PATH,
    "extrinsic": PATH,
    "topics.*": PATH,
    "tolerance_s": number(0, 60, above=True),
    "offset_s": number(-86_400, 86_400),
    "every": COUNT,
    "dataset.camera": PATH,
    "dataset.lidar": PATH,
    "dataset.workers": either(number(0, 256, whole=True), None),
    "dataset.root": TEXT,
    "dataset.name": TEXT,
    "dataset.label": TEXT,
    "dataset.drives": NAMES,
    "dataset.sequences": NAMES,
    "dataset.recording.drives": NAMES,
    "dataset.recording.sequences": NAMES,
    "dataset.split_by": words("frame", "block", "drive", "rig", "official"),
    "dataset.mcd_chunk": ROWS,
    "dataset.image_size": either(listed(number(32, 4096, whole=True), 2), None),
    "dataset.focal_px": either(number(1, 1e5), None),
    "dataset.max_epochs": COUNT,
    "dataset.validations": COUNT,
    "dataset*.stride": COUNT,
    "stride": COUNT,
    "overlays": number(0, 1_000_000, whole=True),
    "patience_s": number(0, 1e9),
    "*_topic": PATH,
    "dataset*.window_ms": number(0.001, 60_000),
    "dataset*.min_events": number(0, 1e9, whole=True),
    "dataset.loader.batch_size": number(1, 65_536, whole=True),
    "dataset.loader.eval_batch_size": number(1, 65_536, whole=True),
    "dataset.loader.workers": number(0, 256, whole=True),
    "split.by": words("frame", "block", "drive", "rig", "official"),
    "split.fractions": listed(SHARE, 4, total=1),
    "split.test_drives": either(listed(TEXT), None),
    "split.official.fractions": listed(number(0, 1, above=True, below=True), 3, total=1),
    "split.official.held_out": LEVEL,
    "split.block_frames": COUNT,
    "split.block_gap": number(0, 1_000_000, whole=True),
    "split.unseen_rigs": RATE,
    "split.train_frames": either(COUNT, None),
    "model.backbone_dropout": RATE,
    "model.head_dropout": RATE,
    "model.*dropout": RATE,
    "model.start.inflation": number(1, 1e4),
    "model.edges": number(0, 65_536, whole=True),
    "model.ridge": number(0, 1e6, above=True),
    "model.displacement_weight": number(0, 1e6),
    "model.inputs.rgb_std": number(0, 1e6, above=True),
    "model.inputs.events.bins": number(1, 1000, whole=True),
    "model.inputs.events.tau_us": number(0, 1e9, above=True),
    "model.optimization.warmup_fraction": SHARE,
    "model.optimization.optimizer.lr": number(0, 1e9, above=True),
    "model.optimization.optimizer.weight_decay": number(0, 1e6),
    "model.*.pretrained": PATH,
    "trainer.max_epochs": COUNT,
    "trainer.gradient_clip_val": either(number(0, 1e9), None),
    "trainer.log_every_n_steps": number(0, 1_000_000, whole=True),
    "trainer.num_sanity_val_steps": number(-1, 1_000_000, whole=True),
    "trainer.limit_*_batches": either(number(0, 1e9, above=True), None),
    "trainer.devices": either(
        number(-1, 1024, whole=True), listed(number(0, 1023, whole=True)), TEXT
    ),
    "trainer.precision": either(TEXT, number(16, 64, whole=True), None),
    "callbacks.*.levels": LEVELS,
    "callbacks.*.level": LEVEL,
    "callbacks.*.monitored": either(COUNT, None),
    "callbacks.*.frames": number(0, 10_000, whole=True),
    "callbacks.interval_overlays.dof": words(*DOF_NAMES),
    "callbacks.*.every_n_epochs": either(number(0, 1_000_000, whole=True), None),
    "callbacks.checkpoint.monitor": words(
        *("loss/train", "loss/validation", "relative error/mean"),
        *(f"relative error/{name}" for name in DOF_NAMES),
    ),
}


SIZES = number(0, 8192, whole=True)
"""Of whole numbers in a network: beyond, it would not fit into memory."""


def bounds_of(key: str) -> Rule | None:
    """The rule of a dotted key; None where it has none of its own.

    >>> bounds_of("mcd.passes").holds(1.5), bounds_of("model.name")
    (False, None)
    """
    return next((rule for name, rule in BOUNDS.items() if fnmatchcase(key, name)), None)
