"""What figures of a multirun call things."""

from __future__ import annotations

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.predictions import BAND_CONFIDENCE

KINDS = (("Translation", DOF_UNITS[0], DOF_NAMES[:3]), ("Rotation", DOF_UNITS[3], DOF_NAMES[3:]))

ERRORS = {"mae_after": "MC mean", "mae_single": "one pass without dropout"}
"""Columns of mean absolute errors."""

POSE = {"together": "six at once", "joint": "joint box", "bonferroni": "Bonferroni"}
"""Columns of coverage of the whole pose."""

KEY_NAMES = {
    "mcd.passes": "stochastic passes",
    "mcd.masks": "masks",
    "model.backbone_dropout": "backbone dropout rate",
    "model.head_dropout": "head dropout rate",
    "dataset.simulation.lidar.beams": "LiDAR beams",
    "dataset.simulation.n_rigs": "rigs",
    "split.train_frames": "training frames",
    "interval": "interval method",
    "split.by": "split by",
    "split.test": "test set",
}
"""What swept keys are called in a figure; others by themselves."""

LAW = (
    "Shaded: where the Beta-Binomial law of split conformal intervals puts one degree of freedom "
    f"with probability {100 * BAND_CONFIDENCE:g} % if frames are exchangeable; a yardstick for "
    "other methods and splits."
)

LAW_LABEL = f"{100 * BAND_CONFIDENCE:g} % band of the exact law"

POSE_WORDS = (
    "How often all six degrees of freedom are held at once: by the six intervals together, which "
    "nobody promises, and by boxes made for it, the joint one and Bonferroni's."
)


def key_name(key: str) -> str:
    """What a swept key is called in a figure.

    Args:
        key: as on a command line.
    """
    return KEY_NAMES.get(key, key)


def sentence(words: str) -> str:
    """A name as the first word of a line; a key stays as it is typed.

    Args:
        words: of :func:`key_name`.

    >>> sentence("stochastic passes"), sentence("trainer.max_epochs")
    ('Stochastic passes', 'trainer.max_epochs')
    """
    return words if "." in words else words[:1].upper() + words[1:]
