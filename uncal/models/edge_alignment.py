"""Alignment of LiDAR edges with image gradients, nothing learnt: what every network must beat."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.data.network_input import NetworkInput
from uncal.edges.evidence import NEAREST_M
from uncal.edges.image import IMAGE_EDGES, edge_maps
from uncal.edges.sweep import KIND, KINDS, N_ACROSS, STRENGTH
from uncal.errors import ConfigurationError, UncalError
from uncal.geometry.decalibration import correct
from uncal.geometry.transforms import transform_points
from uncal.models.answer import Answer, Question, State
from uncal.models.operators import EAGER, Operators
from uncal.models.pose_search import LogLikelihood, SearchSettings, search


class EdgeAlignment(nn.Module):
    """How well the edges of a sweep lie on those of an image, as a log-likelihood of the pose.

    The score of a pose is the weighted sum, over the edges, of the blurred edge strength of the
    image where the pose puts them, above what is usual: an edge that leaves the image counts
    neither for nor against. What is usual is the image's mean, or better the mean nearby: else
    edges without a partner favour poses that bring them to where the image has many edges, such as
    towards the vanishing point, which is a bias common to the frames of a window. A constant turns
    the score into a log-likelihood; it stands for how much edges that are near one another repeat
    one another.

    Args:
        in_channels: C of the input; only the camera's channels are read.
        camera_channels: the first channels of the input are the camera's.
        image_edges: what image gradients are taken of; see :func:`uncal.edges.image.edge_maps`.
        window: half the side of the area that edges are normalised in, pixels.
        kinds: weight of each of :data:`~uncal.edges.sweep.KINDS`.
        blur_deg: width of the blur of each scale, degrees at the image's centre, coarse to fine.
        rounds: of the search at each scale.
        sharpness: log-likelihood by score, of each scale.
        every: at each scale every so many-th edge is looked at, and counts as that many;
            None, as in the settings of older weights: all.
        surround: at each scale, width of the Gaussian that what is usual is a mean over, in widths
            of the blur; 0, and None, as in the settings of older weights: the whole image.

    Raises:
        ConfigurationError: a setting is out of its range.
    """

    reads_edges = True
    weights: Tensor
    blur: Tensor
    sharpness: Tensor

    def __init__(
        self,
        in_channels: int,
        camera_channels: int,
        image_edges: str,
        window: int,
        kinds: Sequence[float],
        blur_deg: Sequence[float],
        rounds: Sequence[int],
        sharpness: Sequence[float],
        every: Sequence[int] | None = None,
        surround: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        every = [1] * len(rounds) if every is None else every
        surround = [0.0] * len(rounds) if surround is None else surround
        if image_edges not in IMAGE_EDGES:
            raise ConfigurationError(
                f"model.image_edges={image_edges}: expected {' or '.join(IMAGE_EDGES)}"
            )
        if len(kinds) != len(KINDS) or min(kinds) < 0 or max(kinds) <= 0:
            raise ConfigurationError(
                f"model.network.kinds={list(kinds)}: expected a weight, at least 0, for each of "
                f"{', '.join(KINDS)}"
            )
        scales = (blur_deg, rounds, sharpness, every)
        least = min((value for scale in scales for value in scale), default=0)
        if len(set(map(len, (*scales, surround)))) != 1 or least <= 0:
            raise ConfigurationError(
                f"model.network: blur_deg={list(blur_deg)}, rounds={list(rounds)}, "
                f"sharpness={list(sharpness)}, every={list(every)}, surround={list(surround)}: "
                "expected positive numbers, as many of each"
            )
        if any(width != 0 and width <= 1 for width in surround):
            raise ConfigurationError(
                f"model.network.surround={list(surround)}: expected 0 or more than 1, a wider blur"
            )
        self.camera_channels = camera_channels
        self.image_edges = image_edges
        self.window = window
        self.rounds = tuple(rounds)
        self.every = tuple(every)
        self.surround = tuple(surround)
        # Buffers, so that a calibrator fitted with other ones is not taken for this one's.
        self.register_buffer("weights", torch.tensor([float(weight) for weight in kinds]))
        self.register_buffer("blur", torch.deg2rad(torch.tensor(list(blur_deg))))
        self.register_buffer("sharpness", torch.tensor([float(value) for value in sharpness]))

    @property
    def widest_blur(self) -> float:
        """Standard deviation of the widest Gaussian that maps are blurred with, radians."""
        widths = self.blur.new_tensor(self.surround).clamp(min=1.0)
        return float((self.blur * widths).max())

    def forward(self, pose: Tensor) -> Tensor:
        """The pose as it is: the search is over before passes begin, and nothing in it is random.

        Args:
            pose: (B, 6).
        """
        return pose

    def weigh(self, edges: Tensor, T: Tensor) -> Tensor:
        """How much each edge counts.

        Args:
            edges: (B, M, columns); rows of NaN pad.
            T: (B, 4, 4) extrinsics as they are assumed.

        Returns:
            (B, M); 0 for rows that pad, and for edges beside or behind the camera's plane.
        """
        present = ~edges[..., 0].isnan()
        edges = edges.nan_to_num()
        ahead = transform_points(T, edges[..., :3])[..., 2] > NEAREST_M
        strength = edges[..., STRENGTH].clamp(0.02, 1.0).sqrt()
        return self.weights[edges[..., KIND].long()] * strength * (present & ahead)

    def maps(self, x: Tensor) -> Tensor:
        """(B, 2, H, W) edge strength across columns and across rows, of (B, C, H, W) input."""
        return edge_maps(x[:, : self.camera_channels], self.window, self.image_edges)

    def unusual(self, maps: Tensor, focal: Tensor, level: int, operators: Operators) -> Tensor:
        """Blurred edge strength above what is usual.

        Args:
            maps: (B, 2, H, W) of :meth:`maps`.
            focal: (B,) pixels.
            level: scale.
            operators: as of :meth:`EdgeAlignmentEstimator.align`.

        Returns:
            (B, 2, H, W).
        """
        sigma = self.blur[level] * focal
        strength = operators.blur(maps, sigma)
        width = self.surround[level]
        if width == 0:
            return strength - strength.mean((2, 3), keepdim=True)
        return strength - operators.blur(maps, width * sigma)


def score(strength: Tensor, edges: Tensor, weights: Tensor, K: Tensor, T: Tensor) -> Tensor:
    """Weighted sum of the edge strength under projected edges, for many extrinsics at once.

    Args:
        strength: (B, 2, H, W) across columns and across rows.
        edges: (B, M, columns) finite.
        weights: (B, M).
        K: (B, 3, 3) camera matrices.
        T: (B, P, 4, 4) extrinsics.

    Returns:
        (B, P).
    """
    height, width = strength.shape[-2:]
    # Camera and grid in one matrix, since what is done for each edge under each pose costs most of
    # a search. grid_sample's borders are the outer edges of the outermost pixels.
    zero, one = torch.zeros_like(K[:, 0, 0]), torch.ones_like(K[:, 0, 0])
    column = torch.stack([2 * K[:, 0, 0], zero, 2 * K[:, 0, 2] + 1 - width], -1) / width
    row = torch.stack([zero, 2 * K[:, 1, 1], 2 * K[:, 1, 2] + 1 - height], -1) / height
    camera = torch.stack([column, row, torch.stack([zero, zero, one], -1)], 1)
    matrices = camera[:, None] @ T[..., :3, :]
    homogeneous = F.pad(edges[..., :3], (0, 1), value=1.0)
    places = homogeneous @ matrices[:, :, :2].flatten(1, 2).transpose(1, 2)
    depth = (homogeneous @ matrices[:, :, 2].transpose(1, 2)).clamp(min=NEAREST_M)
    grid = places.reshape(*places.shape[:2], -1, 2) * depth.reciprocal()[..., None]
    found = F.grid_sample(strength, grid, padding_mode="zeros", align_corners=False)
    along = (edges[..., KIND] >= N_ACROSS).to(weights.dtype)
    of_directions = torch.stack([weights * (1.0 - along), weights * along], 1)
    return (of_directions[:, :, None] @ found).squeeze(2).sum(1)


class EdgeAlignmentEstimator(nn.Module):
    """Searches the pose whose edges lie best on the image's; frames of a window are added up.

    Args:
        network: gives edge strengths and weights.
        bounds: (6,) range of the decalibrations, metres and radians.
        settings: of the search.
    """

    bounds: Tensor

    def __init__(self, network: EdgeAlignment, bounds: Tensor, settings: SearchSettings) -> None:
        super().__init__()
        self.network = network
        self.settings = settings
        self.register_buffer("bounds", bounds.clone())

    @property
    def repeated(self) -> nn.Module:
        """What passes repeat; see :meth:`EdgeAlignment.forward`."""
        return self.network

    def align(self, batch: NetworkInput, operators: Operators = EAGER) -> State:
        """Mean and covariance of the pose of every unit, in units of the range.

        Args:
            batch: B frames of n units.
            operators: others where an exported graph lacks the usual ones.
        """
        # Pixels and metres need more than half precision.
        with torch.no_grad(), torch.autocast(batch.x.device.type, enabled=False):
            maps = self.network.maps(batch.x.float())
            weights = self.network.weigh(batch.edges, batch.T_init)
            edges = batch.edges.nan_to_num()
            rounds: list[LogLikelihood] = []
            for level, number in enumerate(self.network.rounds):
                strength = self.network.unusual(maps, batch.K[:, 0, 0], level, operators)
                every = self.network.every[level]
                strength = strength * (every * self.network.sharpness[level])
                some = (edges[:, ::every], weights[:, ::every])
                likelihood = partial(self._likelihood, batch, strength, *some)
                rounds += [likelihood] * number
            return search(
                rounds, len(batch.unit_index), self.settings, operators.cholesky, operators.ndtr
            )

    def _likelihood(
        self, batch: NetworkInput, strength: Tensor, edges: Tensor, weights: Tensor, pose: Tensor
    ) -> Tensor:
        """(n, P) of (n, P, 6) poses in units of the range."""
        move = (pose.to(self.bounds) * self.bounds)[batch.unit]
        T = correct(batch.T_init[:, None], move)
        of_frames = score(strength, edges, weights, batch.K, T)
        return of_frames.new_zeros(len(pose), pose.shape[1]).index_add(0, batch.unit, of_frames)

    def pose(self, batch: NetworkInput) -> Tensor:
        """(n, 6) estimates, metres and radians."""
        return self.align(batch).pose * self.bounds

    def question(self, batch: NetworkInput) -> Question:
        """The whole search; passes have nothing to add."""
        state = self.align(batch)
        return Question(((state.pose * self.bounds)[batch.unit],), state)

    def answer(self, samples: Tensor, batch: NetworkInput, question: Question) -> Answer:
        """The pose of each unit, and its covariance under the search.

        Args:
            samples: (N, B, 6), the same for all frames of a unit.
            batch: the same batch.
            question: what was asked.

        Returns:
            (N, n, 6) poses and (n, 6, 6) covariance, metres and radians.
        """
        assert question.state is not None
        units = torch.arange(len(batch.unit_index), device=batch.unit.device)
        first = torch.searchsorted(batch.unit, units)
        scales = self.bounds[:, None] * self.bounds
        return Answer(samples[:, first], question.state.covariance * scales)

    def loss(self, batch: NetworkInput) -> Tensor:
        """There is none.

        Raises:
            UncalError: always.
        """
        raise UncalError("model=edges has no parameters, so that there is nothing to train")
