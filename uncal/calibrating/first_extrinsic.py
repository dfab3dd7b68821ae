"""A first extrinsic from recordings, where none is trusted."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.calibrating.edge_search import EdgeField, refine, search_wide
from uncal.data.dataset import Sample, collate
from uncal.data.network_input import make_input
from uncal.decalibration import DecalibrationRange
from uncal.errors import FrameError, RecordingError
from uncal.models.pose_search import SearchSettings
from uncal.monitor.evidence import Estimate, EvidenceReader
from uncal.monitor.extrinsic import after_step
from uncal.monitor.settings import SensorLimits
from uncal.recordings.frame import Frame, Recording

log = logging.getLogger(__name__)

Matrix = NDArray[np.float64]

WINDOW_PX = 15
"""Half the side of the area that image edges are normalised in."""


@dataclass(frozen=True)
class FirstExtrinsic:
    """What the frames say, without a reference.

    Attributes:
        T_cam_lidar: (4, 4).
        std: (6,) σ of the network's last round, metres and radians, LiDAR frame.
        last: (6,) correction of the last round: a search that has arrived makes none.
        frames: that it is made of.
    """

    T_cam_lidar: Matrix
    std: Matrix
    last: Matrix
    frames: int
    searched: Matrix


SETTINGS = SearchSettings(samples=512, effective=40, widening=1.5)
"""Of the search over the whole range."""


def load_frames(recording: Recording, most: int) -> list[Frame]:
    """Readable frames, spread evenly over the recording.

    Args:
        recording: of one rig.
        most: how many at most.

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
    """Frames with the edges that an extrinsic near the guess may bring into the image.

    Args:
        frames: of one rig.
        reader: the weights, which say what images look like to the network.
        T_guess: (4, 4) LiDAR to camera.
        within: how far the guess may be off.
    """
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


def rounds_of_network(
    frames: Sequence[Frame],
    reader: EvidenceReader,
    T_start: Matrix,
    rounds: int,
    limits: SensorLimits,
) -> tuple[Matrix, Estimate]:
    """The network on all frames together, again from what it has found.

    Args:
        frames: of one rig.
        reader: the weights.
        T_start: (4, 4) LiDAR to camera.
        rounds: how often.
        limits: fewest edges of a frame.

    Returns:
        (4, 4) LiDAR to camera, and the last round's estimate.

    Raises:
        RecordingError: no frame has enough edges in the image.
    """
    T = T_start
    for _ in range(rounds):
        evidence = []
        for frame in frames:
            try:
                evidence.append(reader.evidence(frame, T, limits).equations)
            except FrameError as error:
                log.warning("skipped %s: %s", frame.id, error)
        if not evidence:
            raise RecordingError("no frame has enough edges of its sweep in the image")
        estimate = reader.solve(torch.stack(evidence).sum(0))
        T = after_step(T, estimate.mean)
    return T, estimate


def search_and_solve(
    frames: Sequence[Frame],
    reader: EvidenceReader,
    field: EdgeField,
    T_guess: Matrix,
    within: DecalibrationRange,
    settings: SearchSettings,
    limits: SensorLimits,
    starts: int = 3,
) -> FirstExtrinsic:
    """Search the whole range without the network, then let the network go on in rounds."""
    bounds = within.bounds.double().numpy()
    searched = search_wide(field, T_guess, bounds, settings, starts)
    T, estimate = rounds_of_network(frames, reader, searched, 4, limits)
    return FirstExtrinsic(T, estimate.std, estimate.mean, len(frames), searched)
