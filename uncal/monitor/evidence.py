"""From a frame and the extrinsic assumed for it to normal equations, and from those to a pose."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import OmegaConf
from torch import Tensor

from uncal.data.dataset import FrameDataset, Sample, collate
from uncal.data.image_size import size_at_focal
from uncal.data.network_input import InputSettings, NetworkInput, make_input
from uncal.edges.evidence import pack, unpack
from uncal.errors import FrameError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.models.alignment import PRIOR, AlignmentEstimator
from uncal.models.answer import Answer, Estimator, Prior, State
from uncal.models.edge_alignment import EdgeAlignmentEstimator
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import frame_seed, spread_of
from uncal.monitor.settings import SensorLimits
from uncal.monitor.statistics import frame_statistics
from uncal.recordings.frame import Frame, FrameId
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.runs.evaluation_settings import focal_of
from uncal.uncertainty.dropout.layers import only_active

AVERAGED = 1e4
"""Precision of a frame's pose, in units of the range, where a network has no normal equations: the
same for all frames, and so large that the prior does not count. Windows are then plain means."""


class Evidence(NamedTuple):
    """What one frame says.

    Attributes:
        equations: (N, 27) packed normal equations of each stochastic pass, of the whole
            decalibration of the extrinsic assumed, in units of the range; without the prior.
        statistics: (K,) :data:`uncal.monitor.statistics.STATISTICS`.
        prior: what the estimator knew of this frame before its rounds; None: nothing.
    """

    equations: Tensor
    statistics: NDArray[np.float64]
    prior: Prior | None = None


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
        weights: a checkpoint of ``uncal.train``, or shipped weights.
        device: where the network runs.
        seed: of the dropout masks.

    Attributes:
        counts_start: whether the evidence holds what each frame's start has found; otherwise it is
            the prior that goes with it.
        seconds: spent so far in :meth:`prepare` and :meth:`read`.

    Raises:
        ConfigurationError: no such weights.
    """

    def __init__(self, weights: Path, device: torch.device, seed: int) -> None:
        self.recipe = read_recipe(weights)
        self.module: CalibrationModule = build_module(self.recipe)
        load_weights(self.module, weights, calibrated=True)
        self.module.to(device).eval()
        self.device = device
        self.seed = seed
        self.range: DecalibrationRange = instantiate(self.recipe.decalibration)
        self.inputs: InputSettings = instantiate(self.recipe.model.inputs)
        self.focal_px = focal_of(self.recipe)
        self.bounds: NDArray[np.float64] = self.range.bounds.double().numpy()
        self.counts_start = True
        self.seconds = {"prepare": 0.0, "read": 0.0}
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
        sample = self.prepare(frame, T_assumed)
        prepared = time.perf_counter()
        self.seconds["prepare"] += prepared - begin
        if self._reads_edges and len(sample.edges) < limits.min_edges:
            raise FrameError(
                f"{len(sample.edges)} edges of the sweep in the image, fewer than "
                f"{limits.min_edges}"
            )
        evidence = self.read(sample)
        self.seconds["read"] += time.perf_counter() - prepared
        return evidence

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
        if self._reads_edges:  # and draws no points, whose projection would be for nothing
            batch = batch._replace(points=batch.points[:, :1])
        batch = batch.to(self.device)
        with torch.inference_mode():
            inputs = make_input(batch, torch.zeros(1, 6, device=self.device), self.inputs)
            equations, residual, prior = self._equations(inputs, sample.frame)
        alone = self.solve(equations)
        statistics = frame_statistics(sample, residual, float(np.log(alone.std).mean()))
        return Evidence(equations, statistics, prior)

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

    @property
    def _estimator(self) -> Estimator:
        return cast(Estimator, self.module.estimator)

    @property
    def _reads_edges(self) -> bool:
        return isinstance(self._estimator, AlignmentEstimator | EdgeAlignmentEstimator)

    def _equations(
        self, inputs: NetworkInput, frame: FrameId
    ) -> tuple[Tensor, float, Prior | None]:
        """(N, 27), the solver's residual and the prior of this frame."""
        estimator = self._estimator
        with only_active(self.module.estimator, []):
            question = estimator.question(inputs)
        seeds = [frame_seed(self.seed, "monitor", frame)]
        samples = self.module.engine(*question.arguments, seed=seeds).samples
        assert samples is not None
        if isinstance(estimator, AlignmentEstimator):
            assert question.state is not None
            normal, right = unpack(samples[:, 0])
            # Of what is left after the rounds before; the whole is that and what they found.
            whole = right + normal @ question.state.pose[0]
            with only_active(self.module.estimator, []):
                residual = estimator.last.residual(*question.arguments)
            prior = question.state.prior
            if prior is not None and self.counts_start:
                # What the start has found adds up over a window as the rest does.
                known = _beyond(prior.precision[0], PRIOR / estimator.start_inflation)
                normal, whole, prior = normal + known, whole + known @ prior.mean[0], None
            return pack(normal, whole), float(residual), prior
        if isinstance(estimator, EdgeAlignmentEstimator):
            assert question.state is not None
            pose, covariance, _ = question.state
            return _without_prior(pose.float(), covariance.float()), 0.0, None
        poses = estimator.answer(samples, inputs, question).samples[:, 0, :6]
        return averaged(poses / self.range.bounds.to(poses)), 0.0, None

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


def averaged(poses: Tensor) -> Tensor:
    """Poses of a network without normal equations as such; see :data:`AVERAGED`.

    Args:
        poses: (N, 6) in units of the range.

    Returns:
        (N, 27).
    """
    normal = (AVERAGED * torch.eye(6).to(poses)).expand(len(poses), 6, 6)
    return pack(normal, AVERAGED * poses)


def _without_prior(pose: Tensor, covariance: Tensor) -> Tensor:
    """(1, 27) what a search has found beyond the prior, whose mean is zero."""
    information = torch.linalg.inv(covariance[0])
    return pack(_beyond(information, PRIOR), information @ pose[0])[None]


def _beyond(information: Tensor, precision: float) -> Tensor:
    """(6, 6) information without that of a prior of this precision, at least none."""
    eye = torch.eye(6).to(information)
    values, vectors = torch.linalg.eigh(information - precision * eye)
    rest: Tensor = (vectors * values.clamp(min=0)) @ vectors.T
    return rest
