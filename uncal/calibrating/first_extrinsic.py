"""A first extrinsic from recordings, where none is trusted."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.calibrating.edge_search import EdgeField, refine, search_wide
from uncal.data.dataset import Sample, collate
from uncal.data.network_input import make_input
from uncal.errors import FrameError, RecordingError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.geometry.transforms import matrix_to_pose
from uncal.models.pose_search import SearchSettings
from uncal.monitor.evidence import Estimate, EvidenceReader
from uncal.monitor.extrinsic import after_step
from uncal.monitor.references import References
from uncal.monitor.settings import MonitorSettings
from uncal.recordings.frame import Frame, Recording

log = logging.getLogger(__name__)

Matrix = NDArray[np.float64]

WINDOW_PX = 15
"""Half the side of the area that image edges are normalised in."""


SEARCH = SearchSettings(samples=384, effective=32, widening=1.5)
"""Of one search over the whole range."""

STARTS, SEARCH_EDGES, ROUNDS = 2, 384, 2
"""Searches, edges of a frame that they look at, and rounds of the network after them."""


@dataclass(frozen=True)
class FirstExtrinsic:
    """What the frames say, without a reference."""

    T_cam_lidar: Matrix  # (4, 4) after search, refinement and network
    half: Matrix  # (6,) half the width of the interval of each DoF, metres and radians, LiDAR frame
    covariance: Matrix  # (6, 6) of a normal law with such intervals
    searched: Matrix  # (4, 4) after the search alone
    refined: Matrix  # (4, 4) after the refinement, before the network
    frames: int  # that it is made of


def load_frames(recording: Recording, most: int) -> list[Frame]:
    """At most so many readable frames, spread evenly over the recording of one rig.

    Raises:
        RecordingError: none can be read.
    """
    ids = recording.frame_ids
    chosen = [ids[i * len(ids) // min(most, len(ids))] for i in range(min(most, len(ids)))]
    frames = []
    for frame_id in chosen:
        try:
            frames.append(recording.load(frame_id))
        except FrameError as error:
            log.warning("skipped %s: %s", frame_id, error)
    if not frames:
        raise RecordingError(f"none of {len(chosen)} frames can be read")
    return frames


def edge_field(
    frames: Sequence[Frame], reader: EvidenceReader, T_guess: Matrix, within: DecalibrationRange
) -> EdgeField:
    """Frames with the edges that an extrinsic near the guess may bring into the image."""
    samples: list[Sample] = []
    for place, frame in enumerate(frames):
        dataset = copy.copy(reader.dataset(frame))
        dataset.decalibration = within
        guessed = replace(frame, T_cam_lidar=T_guess)
        samples.append(dataset.sample(guessed, place, torch.zeros(6)))
    batch = collate([[sample] for sample in samples])
    batch = batch._replace(points=batch.points[:, :1])
    inputs = make_input(batch, torch.zeros(len(samples), 6), reader.inputs)
    model = reader.recipe.model
    return EdgeField(inputs, WINDOW_PX, reader.inputs.camera_channels, model.image_edges)


def first_extrinsic(
    frames: Sequence[Frame],
    reader: EvidenceReader,
    T_guess: Matrix,
    within: DecalibrationRange,
    references: References,
    settings: MonitorSettings,
) -> FirstExtrinsic:
    """Search the whole range, climb on edges, and let the network go on from there.

    The interval is that of the monitor's references: drives with trusted extrinsics on which the
    network, within its range, was as wrong as that. More frames than their window has do not make
    it narrower, since what is common to a rig does not average out, and it reaches at least as far
    as refinement and network differ.

    Raises:
        RecordingError: no frame has enough edges in the image.
    """
    field = edge_field(frames, reader, T_guess, within)
    bounds = within.bounds.double().numpy()
    searched = search_wide(field.fewer(SEARCH_EDGES), T_guess, bounds, SEARCH, STARTS)
    refined = refine(field, searched)
    T, estimate, used = rounds_of_network(frames, reader, refined, ROUNDS, settings)
    calibrators = references.calibrators(settings.exchangeable)
    calibrator = calibrators[min(used, len(calibrators)) - 1]
    of_references = calibrator.quantile(settings.level).numpy() * estimate.std
    apart = torch.linalg.inv(torch.from_numpy(refined)) @ torch.from_numpy(T)
    half = np.maximum(of_references, matrix_to_pose(apart).abs().numpy())
    scale = half / estimate.std / NormalDist().inv_cdf((1 + settings.level) / 2)
    covariance = estimate.covariance * np.outer(scale, scale)
    return FirstExtrinsic(T, half, covariance, searched, refined, len(frames))


def rounds_of_network(
    frames: Sequence[Frame],  # of one rig
    reader: EvidenceReader,
    T_start: Matrix,  # (4, 4) LiDAR to camera
    rounds: int,  # how often
    settings: MonitorSettings,  # of the monitor: fewest edges, and the most frames that σ is for
) -> tuple[Matrix, Estimate, int]:
    """The network on all frames together, again from what it has found.

    Returns:
        (4, 4) LiDAR to camera, the last round's estimate, and the frames in it.

    Raises:
        RecordingError: no frame has enough edges in the image.
    """
    T = T_start
    for _ in range(rounds):
        evidence = []
        for frame in frames:
            try:
                evidence.append(reader.evidence(frame, T, settings.sensors).equations)
            except FrameError as error:
                log.warning("skipped %s: %s", frame.id, error)
        if not evidence:
            raise RecordingError("no frame has enough edges of its sweep in the image")
        mean = torch.stack(evidence).mean(0)
        T = after_step(T, reader.solve(mean * len(evidence)).mean)
        # Of no more frames than the references know.
        estimate = reader.solve(mean * min(len(evidence), settings.window))
    return T, estimate, len(evidence)
