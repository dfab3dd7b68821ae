"""``trusted=false``: a first extrinsic, with what can and cannot be said of its error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from uncal.calibrating.edge_search import edge_field
from uncal.calibrating.first_extrinsic import first_extrinsic, load_frames
from uncal.decalibration import DecalibrationRange
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.settings import MonitorSettings
from uncal.recordings.frame import Recording
from uncal.recordings.static_transform import StaticTransform

WARNING = (
    "No reference, no guarantee: this interval comes from simulated rigs, where the search is known "
    "to arrive; nothing says that it holds here. Look at the overlay of python -m uncal.check, and "
    "measure the extrinsic in another way before it is trusted."
)


def find_first(config: DictConfig, weights: Path, stem: Path) -> list[str]:
    """Find a first extrinsic and write it for ROS.

    Args:
        config: conf/calibrate.yaml with overrides; the recordings' extrinsic is the guess.
        weights: a checkpoint, or shipped weights.
        stem: of the files to write.

    Returns:
        Lines for the user.

    Raises:
        ConfigurationError: the recordings are of several rigs, or the weights read events.
    """
    reader = EvidenceReader(weights, torch.device("cpu"), config.seed)
    if reader.inputs.camera != "rgb" or reader.inputs.edges == 0:
        raise ConfigurationError(
            f"{weights}: a first extrinsic takes a network that reads rgb and edges, such as unical"
        )
    recording: Recording = instantiate(config.dataset.recording)
    rigs = sorted({frame.rig for frame in recording.frame_ids})
    if len(rigs) != 1:
        raise ConfigurationError(
            f"{config.recordings}: {len(rigs)} rigs ({', '.join(rigs[:5])} …), each of which has "
            "an extrinsic of its own: choose the drives of one with dataset.drives=[…]"
        )
    frames = load_frames(recording, config.guess.frames)
    within = DecalibrationRange(config.guess.rotation_deg, config.guess.translation_cm)
