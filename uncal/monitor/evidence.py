"""From a frame and the extrinsic assumed for it to normal equations, and from those to a pose."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import OmegaConf
from torch import Tensor

from uncal.data.dataset import FrameDataset, Sample, collate
from uncal.data.image_size import Fit, size_at_focal
from uncal.data.network_input import InputSettings, make_input
from uncal.edges.evidence import pack, unpack
from uncal.errors import FrameError
from uncal.geometry.decalibration import DecalibrationRange, correct
from uncal.models.alignment import AlignmentEstimator
from uncal.models.answer import Answer, Prior, State
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import frame_seed, spread_of
from uncal.monitor.equations import Asker
from uncal.monitor.pairing import Glimpse, PairingCheck, fit, glimpse
from uncal.monitor.settings import SensorLimits
from uncal.monitor.statistics import frame_statistics
from uncal.recordings.frame import Frame, FrameId
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.runs.evaluation_settings import focal_of


class Evidence(NamedTuple):
    """What one frame says.

    Attributes:
        equations: (N, 27) packed normal equations of each stochastic pass, of the whole
            decalibration of the extrinsic assumed, in units of the range; without the prior.
        statistics: (K,) :data:`uncal.monitor.statistics.STATISTICS`.
        prior: what the estimator knew of this frame before its rounds; None: nothing.
        glimpse: for the check of pairings; None where the estimator reads no edges.
    """

    equations: Tensor
    statistics: NDArray[np.float64]
    prior: Prior | None = None
    glimpse: Glimpse | None = None


class Estimate(NamedTuple):
    """What evidence says, added up.

    Attributes:
        mean: (6,) decalibration, metres and radians.
        std: (6,) σ.
        covariance: (6, 6) with those σ.
    """

    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    covariance: NDArray[np.float64]


class _Nothing:
    """A recording without frames: they come one by one."""

    frame_ids: list[FrameId] = []  # noqa: RUF012
    skipped: dict[str, str] = {}  # noqa: RUF012

    def load(self, frame_id: FrameId) -> Frame:
        raise FrameError(f"{frame_id}: frames of a stream cannot be loaded again")


class EvidenceReader:
    """Weights at work on one frame after the other.

    The evidence of a frame is a function of that frame, the extrinsic assumed and the seed alone,
    so that what windows are made of does not depend on what went before.

    Args:
        weights: a checkpoint of ``uncal.train``, shipped weights, or the module that holds them.
        device: where the network runs.
        seed: of the dropout masks.

    Attributes:
        counts_start: whether the evidence holds what each frame's start has found; otherwise it is
            the prior that goes with it.
        seconds: spent so far in each stage.
        sample: of the last frame whose evidence was asked for; for pictures.

    Raises:
        ConfigurationError: no such weights.
    """

    def __init__(self, weights: Path | CalibrationModule, device: torch.device, seed: int) -> None:
        if isinstance(weights, Path):
            self.recipe = read_recipe(weights)
            self.module: CalibrationModule = build_module(self.recipe)
            load_weights(self.module, weights, calibrated=True)
        else:
            self.recipe, self.module = OmegaConf.create(weights.recipe), weights
        self.module.to(device).eval()
        self.device = device
        self.seed = seed
        self.range: DecalibrationRange = instantiate(self.recipe.decalibration)
        self.inputs: InputSettings = instantiate(self.recipe.model.inputs)
        self.focal_px = focal_of(self.recipe)
        self.bounds: NDArray[np.float64] = self.range.bounds.double().numpy()
        self.counts_start = True
        self.seconds = dict.fromkeys(("edges", "start", "network", "passes"), 0.0)
        self.ask = Asker(self.module, self.range.bounds.to(device), self.seconds)
        self.sample: Sample | None = None
        self._datasets: dict[tuple[int, int, float], FrameDataset] = {}

    def evidence(
        self, frame: Frame, T_assumed: NDArray[np.float64], limits: SensorLimits
    ) -> Evidence:
        """What a frame says of an extrinsic.

        Args:
            frame: as a recording loads it; its own extrinsic is not looked at.
            T_assumed: (4, 4) the extrinsic whose decalibration is asked for.
            limits: fewest edges.

        Raises:
            FrameError: there is no image, it cannot be brought to the network's size, or next to
                no edge lies in it.
        """
        begin = time.perf_counter()
        self.sample = None
        self.sample = sample = self.prepare(frame, T_assumed)
        self.seconds["edges"] += time.perf_counter() - begin
        if self.ask.reads_edges and len(sample.edges) < limits.min_edges:
            raise FrameError(
                f"{len(sample.edges)} edges of the sweep in the image, fewer than "
                f"{limits.min_edges}"
            )
        return self.read(sample)

    def prepare(self, frame: Frame, T_assumed: NDArray[np.float64]) -> Sample:
        """A frame at the network's size, culled, with its edges: work for the CPU.

        Args:
            frame: as a recording loads it; its own extrinsic is not looked at.
            T_assumed: (4, 4) the extrinsic whose decalibration is asked for.

        Raises:
            FrameError: there is no image, or it cannot be brought to the network's size.
        """
        assumed = replace(frame, T_cam_lidar=T_assumed)
        return self.dataset(frame).sample(assumed, 0, torch.zeros(6))

    def read(self, sample: Sample) -> Evidence:
        """The evidence of a frame: work for the device.

        Args:
            sample: of :meth:`prepare`.
        """
        batch = collate([[sample]])
        if self.ask.reads_edges:  # and draws no points, whose projection would be for nothing
            batch = batch._replace(points=batch.points[:, :1])
        batch = batch.to(self.device)
        seed = frame_seed(self.seed, "monitor", sample.frame)
        with torch.inference_mode():
            inputs = make_input(batch, torch.zeros(1, 6, device=self.device), self.inputs)
            equations, residual, prior = self.ask(inputs, seed, self.counts_start)
            alone = self.solve(equations)
            seen, fits = None, 0.0
            if self.ask.alignment is not None:
                seen = glimpse(inputs, self.ask.alignment)
                fits = float(fit(seen, seen, self.corrected(inputs.T_init[0], alone)[None]))
        statistics = frame_statistics(sample, fits, residual, float(np.log(alone.std).mean()))
        return Evidence(equations, statistics, prior, seen)

    def doubt(
        self, check: PairingCheck, evidence: Evidence, T_assumed: NDArray[np.float64]
    ) -> str | None:
        """What is wrong with the pairing of image and sweep; None if nothing is.

        Args:
            check: has seen the frames before.
            evidence: of the next frame.
            T_assumed: (4, 4) the extrinsic that the evidence is about.
        """
        if evidence.glimpse is None:
            return None
        T = torch.from_numpy(T_assumed).to(self.device, torch.float32)
        with torch.inference_mode():
            both = torch.stack([T, self.corrected(T, self.solve(evidence.equations))])
            return check.doubt(evidence.glimpse, both)

    @staticmethod
    def corrected(T: Tensor, estimate: Estimate) -> Tensor:
        """(4, 4) extrinsic that an estimate has been taken out of."""
        return correct(T, torch.from_numpy(estimate.mean).to(T))

    def solve(self, equations: Tensor, prior: Prior | None = None) -> Estimate:
        """The decalibration under a prior, given the sum of the evidence.

        Args:
            equations: (N, 27).
            prior: None: uniform over the range, as it is for windows, whose frames would repeat
                each other's priors. With that of the frame it is what the module itself estimates.

        Returns:
            The estimate, with the spread that the weights' calibration names (``mcd.spread``).
        """
        zero = State(equations.new_zeros(1, 6), equations.new_zeros(1, 6, 6), prior)
        poses = AlignmentEstimator.solve(equations[:, None], zero).pose
        covariance = AlignmentEstimator.solve(equations.mean(0)[None], zero).covariance
        bounds = self.range.bounds.to(equations)
        answer = Answer(poses * bounds, covariance * bounds[:, None] * bounds)
        std, of_error = spread_of(answer, self.module.spread)
        found = answer.samples.mean(0), std, of_error
        return Estimate(*(value[0].double().cpu().numpy() for value in found))

    def rebase(self, equations: Tensor, step: NDArray[np.float64]) -> Tensor:
        """The same evidence about an extrinsic that a decalibration has been taken out of.

        To first order: A (x - s) = b - A s.

        Args:
            equations: (..., 27) about the extrinsic before.
            step: (6,) what was taken out, metres and radians.
        """
        normal, right = unpack(equations)
        s = torch.from_numpy(step / self.bounds).to(equations)
        return pack(normal, right - normal @ s)

    def fit(self, frame: Frame) -> Fit:
        """How a frame's image, or its events, come to the network's size.

        Args:
            frame: of the camera that is watched.
        """
        source = frame.image.shape[:2] if frame.image is not None else None
        if source is None:
            assert frame.events is not None
            source = frame.events.size
        return self.dataset(frame).fit((source[0], source[1]), frame.K)

    def dataset(self, frame: Frame) -> FrameDataset:
        """What brings frames of this camera to the network's size.

        Args:
            frame: one of them.

        Raises:
            FrameError: it has neither an image nor events.
        """
        if frame.image is not None:
            source = (frame.image.shape[0], frame.image.shape[1])
        elif frame.events is not None:
            source = frame.events.size
        else:
            raise FrameError(f"{frame.id}: neither an image nor events")
        focal = float(frame.K[0, 0])
        key = (*source, focal)
        if key not in self._datasets:
            trained = OmegaConf.select(self.recipe, "dataset.image_size")
            as_trained = trained is not None and (self.focal_px is None or tuple(trained) == source)
            self._datasets = {
                key: FrameDataset(
                    recording=_Nothing(),
                    units=[],
                    image_size=(int(trained[0]), int(trained[1]))
                    if as_trained
                    else size_at_focal(source, focal, self.focal_px or focal),
                    decalibration=self.range,
                    fixed_seed=None,
                    cache=False,
                    events=self.inputs.events,
                    edges=self.inputs.edges,
                    focal_px=None if as_trained else self.focal_px,
                )
            }
        return self._datasets[key]
