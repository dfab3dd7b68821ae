"""Bounds of the settings, by key; what has none here must be of the kind of the shipped value.

Groups that check themselves (the simulation, the decalibration) are not repeated here. A star
stands for anything; of several entries the first that matches counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

from uncal.geometry.transforms import DOF_NAMES
from uncal.settings.rules import Either, Flag, Listed, Number, Rule, Text, Words

SEED = Number(0, 2**32 - 1, whole=True)
RATE = Number(0, 1, below=True)
SHARE = Number(0, 1)
LEVEL = Number(0, 1, above=True, below=True)
COUNT = Number(1, 1_000_000, whole=True)
NAMES = Either(Listed(Text()), Text(), None)
LEVELS = Listed(LEVEL, distinct=True)
ROWS = Either(COUNT, Words("auto"), None)

BOUNDS: Mapping[str, Rule] = {
    "*seed": SEED,
    "ckpt": Either(Text(), None),
    "store": Either(Text(), None),
    "weights": Either(Text(), None),
    "model.weights": Either(Text(), None),
    "root": Text(),
    "workers": Either(Number(1, 256, whole=True), None),
    "device": Words("auto", "cpu", "cuda"),
    "data_root": Either(Text(), None),
    "passes": Number(1, 10_000, whole=True),
    "rounds": Number(1, 10_000, whole=True),
    "cases.*.size": Listed(Number(32, 4096, whole=True), 2),
    "cases.*.batches": Listed(COUNT),
    "compile": Either(Words("auto"), Flag()),
    "decalibration.rotation_deg": Number(0, 45, above=True),
    "decalibration.translation_cm": Number(0, 1000, above=True),
    "guess.rotation_deg": Number(0, 10, above=True),
    "guess.translation_cm": Number(0, 100, above=True),
    "guess.frames": COUNT,
    "recordings": Text(),
    "augmentation.mirror": SHARE,
    "augmentation.brightness": RATE,
    "augmentation.contrast": SHARE,
    "window.frames": Number(1, 1000, whole=True),
    "mcd.passes": Number(1, 10_000, whole=True),
    "mcd.strategy": Words("auto", "shared", "batch", "loop"),
    "mcd.masks": Words("random", "fixed"),
    "mcd.chunk": ROWS,
    "mcd.layers": Either(Listed(Text()), None),
    "mcd.insert.after": Listed(Text()),
    "mcd.insert.exclude": Listed(Text()),
    "mcd.insert.p": LEVEL,
    "interval.levels": LEVELS,
    "levels": Either(LEVELS, None),
    "image_size": Listed(Number(32, 4096, whole=True), 2),
    "interval.sigma_floor": SHARE,
    "interval.quantile_levels": Listed(LEVEL, 2, rising=True),
    "interval.groups": Words("rig", "drive"),
    "interval.calibrator.repeats": Number(1, 10_000, whole=True),
    "source": Text(),
    "drive": Either(Text(), None),
    "extrinsic": Either(Text(), None),
    "topics.*": Either(Text(), None),
    "tolerance_s": Number(0, 60, above=True),
    "offset_s": Number(-86_400, 86_400),
    "every": COUNT,
    "dataset.camera": Either(Text(), None),
    "dataset.lidar": Either(Text(), None),
    "dataset.workers": Either(Number(0, 256, whole=True), None),
    "dataset.root": Text(),
    "dataset.name": Text(),
    "dataset.label": Text(),
    "dataset.drives": NAMES,
    "dataset.sequences": NAMES,
    "dataset.recording.drives": NAMES,
    "dataset.recording.sequences": NAMES,
    "dataset.split_by": Words("frame", "block", "drive", "rig", "official"),
    "dataset.mcd_chunk": ROWS,
    "dataset.image_size": Either(Listed(Number(32, 4096, whole=True), 2), None),
    "dataset.focal_px": Either(Number(1, 1e5), None),
    "dataset.max_epochs": COUNT,
    "dataset.validations": COUNT,
    "dataset*.stride": COUNT,
    "stride": COUNT,
    "overlays": Number(0, 1_000_000, whole=True),
    "patience_s": Number(0, 1e9),
    "*_topic": Either(Text(), None),
    "dataset*.window_ms": Number(0.001, 60_000),
    "dataset*.min_events": Number(0, 1e9, whole=True),
    "dataset.loader.batch_size": Number(1, 65_536, whole=True),
    "dataset.loader.eval_batch_size": Number(1, 65_536, whole=True),
    "dataset.loader.workers": Number(0, 256, whole=True),
    "split.by": Words("frame", "block", "drive", "rig", "official"),
    "split.fractions": Listed(SHARE, 4, total=1),
    "split.test_drives": Either(Listed(Text()), None),
    "split.official.fractions": Listed(Number(0, 1, above=True, below=True), 3, total=1),
    "split.official.held_out": LEVEL,
    "split.block_frames": COUNT,
    "split.block_gap": Number(0, 1_000_000, whole=True),
    "split.unseen_rigs": RATE,
    "split.train_frames": Either(COUNT, None),
    "model.backbone_dropout": RATE,
    "model.head_dropout": RATE,
    "model.*dropout": RATE,
    "model.start.inflation": Number(1, 1e4),
    "model.edges": Number(0, 65_536, whole=True),
    "model.ridge": Number(0, 1e6, above=True),
    "model.displacement_weight": Number(0, 1e6),
    "model.inputs.rgb_std": Number(0, 1e6, above=True),
    "model.inputs.events.bins": Number(1, 1000, whole=True),
    "model.inputs.events.tau_us": Number(0, 1e9, above=True),
    "model.optimization.warmup_fraction": SHARE,
    "model.optimization.optimizer.lr": Number(0, 1e9, above=True),
    "model.optimization.optimizer.weight_decay": Number(0, 1e6),
    "model.*.pretrained": Either(Text(), None),
    "trainer.max_epochs": COUNT,
    "trainer.gradient_clip_val": Either(Number(0, 1e9), None),
    "trainer.log_every_n_steps": Number(0, 1_000_000, whole=True),
    "trainer.num_sanity_val_steps": Number(-1, 1_000_000, whole=True),
    "trainer.limit_*_batches": Either(Number(0, 1e9, above=True), None),
    "trainer.devices": Either(
        Number(-1, 1024, whole=True), Listed(Number(0, 1023, whole=True)), Text()
    ),
    "trainer.precision": Either(Text(), Number(16, 64, whole=True), None),
    "callbacks.*.levels": LEVELS,
    "callbacks.*.level": LEVEL,
    "callbacks.*.monitored": Either(COUNT, None),
    "callbacks.*.frames": Number(0, 10_000, whole=True),
    "callbacks.interval_overlays.dof": Words(*DOF_NAMES),
    "callbacks.*.every_n_epochs": Either(Number(0, 1_000_000, whole=True), None),
    "callbacks.checkpoint.monitor": Words(
        *("loss/train", "loss/validation", "relative error/mean"),
        *(f"relative error/{name}" for name in DOF_NAMES),
    ),
}


SIZES = Number(0, 8192, whole=True)
"""Of whole numbers in a network: beyond, it would not fit into memory."""


def bounds_of(key: str) -> Rule | None:
    """The rule of a key.

    Args:
        key: dotted.

    >>> bounds_of("mcd.passes").holds(1.5), bounds_of("model.name")
    (False, None)
    """
    return next((rule for name, rule in BOUNDS.items() if fnmatchcase(key, name)), None)
