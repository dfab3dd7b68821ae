"""``trusted=false``: a first extrinsic, with what can and cannot be said of its error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import DictConfig

from uncal.calibrating.first_extrinsic import first_extrinsic, load_frames
from uncal.errors import ConfigurationError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.geometry.transforms import DOF_NAMES, DOF_SCALE, DOF_UNITS, matrix_to_pose
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.references import find_references, fingerprint, references_beside
from uncal.monitor.settings import MonitorSettings
from uncal.recordings.frame import Recording
from uncal.recordings.static_transform import StaticTransform

Matrix = NDArray[np.float64]

WARNING = (
    "No reference, no guarantee: the interval is that of other rigs, whose references come with "
    "the weights, and holds if the search has arrived. Look at the overlay of python -m "
    "uncal.check, and measure the extrinsic in another way before you trust it."
)


def find_first(config: DictConfig, weights: Path, stem: Path) -> list[str]:
    """Find a first extrinsic, with the recordings' as guess, and write it for ROS. Gives lines.

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
    settings = MonitorSettings.shipped()
    references = find_references(weights, fingerprint(reader, settings))
    if references is None:
        raise ConfigurationError(
            f"{weights}: no references for an interval ({references_beside(weights)} is not "
            "there): use weights=unical, or make some with python -m uncal.monitor calibrate=FOLDER"
        )
    frames = load_frames(recording, config.guess.frames)
    within = DecalibrationRange(
        rotation_deg=config.guess.rotation_deg, translation_cm=config.guess.translation_cm
    )
    T_guess = frames[0].T_cam_lidar
    found = first_extrinsic(frames, reader, T_guess, within, references, settings)
    lines = [
        f"From {found.frames} frames of {rigs[0]}; the guess was taken to be right within "
        f"{within.rotation_deg:g}° and {within.translation_cm:g} cm per axis.",
        f"Guess - found: {_listed(_apart(found.T_cam_lidar, T_guess))}",
        f"{settings.level:.0%} interval: ± {_listed(found.half)}",
    ]
    apart = np.abs(_apart(found.refined, found.T_cam_lidar))
    if (apart > reader.bounds).any():
        lines.append(
            f"Edges alone say something else, by {_listed(apart)}: do not trust either of them."
        )
    about = (
        f"First extrinsic of {config.recordings} without a reference; no coverage is guaranteed."
    )
    transform = StaticTransform(
        found.T_cam_lidar, found.covariance, about, config.frame.camera, config.frame.lidar
    )
    lines += [WARNING, "For rig.yaml:", *_for_rig_yaml(found.T_cam_lidar)]
    return [*lines, *map(str, transform.write(stem))]


def _apart(T: Matrix, T_other: Matrix) -> Matrix:
    """(6,) decalibration of the other extrinsic as seen from the first."""
    D = torch.linalg.inv(torch.from_numpy(T)) @ torch.from_numpy(T_other)
    return np.asarray(matrix_to_pose(D).numpy())


def _listed(values: Matrix) -> str:
    parts = zip(DOF_NAMES, values * DOF_SCALE, DOF_UNITS, strict=True)
    return ", ".join(f"{name} {value:.2f} {unit}" for name, value, unit in parts)


def _for_rig_yaml(T: Matrix) -> list[str]:
    rows = (", ".join(f"{value:.8f}" for value in row) for row in T)
    return [f"  - [{row}]" for row in rows]
