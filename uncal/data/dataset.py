"""Frames to samples and samples to batches: the part of the work that workers do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import Dataset

from uncal.data.culling import frustum_mask
from uncal.data.image_size import Fit, fit, fit_focal, resize_and_crop
from uncal.edges.selection import select_edges
from uncal.edges.sweep import COLUMNS, find_edges
from uncal.errors import FrameError
from uncal.events.representations import EventRepresentation
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.frame import Frame, FrameId, Recording
from uncal.recordings.motion import untwisted
from uncal.splits.windows import Unit

_LARGEST = torch.finfo(torch.float16).max


class Sample(NamedTuple):
    """One frame, ready to be batched.

    Attributes:
        unit_index: number of its unit in the split.
        frame: its name.
        camera: (3, H, W) uint8 RGB, or (C, H, W) float16 events as their representation draws them.
        points: (n, 4) float32 culled sweep, LiDAR frame, metres and reflectance.
        edges: (m, columns) float32 edges of the sweep, :data:`uncal.edges.sweep.COLUMNS`.
        K: (3, 3) float32 camera matrix at this size.
        T_cam_lidar: (4, 4) float32 true extrinsic.
        decalibration: (6,) fixed draw of the evaluation splits, or None where training draws anew.
    """

    unit_index: int
    frame: FrameId
    camera: Tensor
    points: Tensor
    edges: Tensor
    K: Tensor
    T_cam_lidar: Tensor
    decalibration: Tensor | None


class SkippedFrame(NamedTuple):
    """A frame that could not be read, and why."""

    frame: FrameId
    reason: str


class Batch(NamedTuple):
    """Samples stacked; sweeps are padded to the longest with rows of NaN, which nothing sees.

    A unit is what one estimate is for: a frame, or a window of frames that share an extrinsic.

    Attributes:
        unit_index: (n,) int64 numbers of the units in their split.
        unit: (B,) int64 which of the n units each frame belongs to, ascending.
        frames: the B frames.
        camera: (B, 3, H, W) uint8 RGB, or (B, C, H, W) float16 events.
        points: (B, N, 4) float32, LiDAR frame.
        edges: (B, M, columns) float32 edges of the sweeps; rows of NaN pad.
        K: (B, 3, 3) float32.
        T_cam_lidar: (B, 4, 4) float32 true extrinsics.
        decalibration: (n, 6), or None where training draws anew.
        skipped: frames left out because they could not be read.
    """

    unit_index: Tensor
    unit: Tensor
    frames: list[FrameId]
    camera: Tensor
    points: Tensor
    edges: Tensor
    K: Tensor
    T_cam_lidar: Tensor
    decalibration: Tensor | None
    skipped: list[SkippedFrame]

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Batch:
        """Move the tensors; Lightning calls it for every batch."""
        return self._map(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Batch:
        """Pin the tensors; the DataLoader calls it where there is a GPU."""
        return self._map(Tensor.pin_memory)

    def _map(self, function: Callable[[Tensor], Tensor]) -> Batch:
        tensors = {k: v for k, v in self._asdict().items() if isinstance(v, Tensor)}
        moved: dict[str, Any] = {name: function(tensor) for name, tensor in tensors.items()}
        return self._replace(**moved)


Item: TypeAlias = "list[Sample | SkippedFrame]"
"""The frames of one unit."""


class FrameDataset(Dataset[Item]):
    """Loads the units of one split, frame by frame, at the network's size and culled.

    Points that no decalibration within the range can bring into the image are left out here, so
    that they are neither copied nor projected; see :mod:`uncal.data.culling`.

    Other arguments are those of :class:`~uncal.data.datamodule.CalibrationDataModule`.

    Args:
        units: the frames of this split, unit by unit.
        decalibration: the range that culling must respect and fixed draws come from.
        fixed_seed: evaluation splits: the decalibration is a pure function of it and the frame's
            name (of a window, its first frame's); None: training, which draws per step on the
            device.
        cache: keep samples in memory after their first use.
        events: draws the events of an event camera; None where no channel shows them.
        edges: most edges of a sweep to keep; 0: find none.
    """

    def __init__(
        self,
        recording: Recording,
        units: Sequence[Unit],
        image_size: tuple[int, int],
        decalibration: DecalibrationRange,
        fixed_seed: int | None,
        cache: bool,
        events: EventRepresentation | None = None,
        edges: int = 0,
        focal_px: float | None = None,
    ) -> None:
        self.recording = recording
        self.units = list(units)
        self.image_size = image_size
        self.decalibration = decalibration
        self.fixed_seed = fixed_seed
        self.events = events
        self.edges = edges
        self.focal_px = focal_px
        self._cache: dict[int, Item] | None = {} if cache else None

    def __len__(self) -> int:
        """Number of units, readable or not."""
        return len(self.units)

    def __getitem__(self, index: int) -> Item:
        """Load one unit; a frame that cannot be read comes back as :class:`SkippedFrame`."""
        if self._cache is None:
            return self._load(index)
        if index not in self._cache:
            self._cache[index] = self._load(index)
        return self._cache[index]

    def _load(self, index: int) -> Item:
        return [self._load_frame(index, frame_id) for frame_id in self.units[index]]

    def _load_frame(self, index: int, frame_id: FrameId) -> Sample | SkippedFrame:
        try:
            frame = self.recording.load(frame_id)
        except FrameError as error:
            return SkippedFrame(frame_id, str(error))
        return self.of_frame(frame, index)

    def of_frame(self, frame: Frame, unit_index: int) -> Sample | SkippedFrame:
        """What a frame of a unit becomes, under the unit's fixed decalibration if there is one."""
        fixed = None
        if self.fixed_seed is not None:
            first = self.units[unit_index][0]
            fixed = self.decalibration.draw_for(self.fixed_seed, str(first))
        try:
            return self.sample(frame, unit_index, fixed)
        except FrameError as error:
            return SkippedFrame(frame.id, str(error))

    def sample(self, frame: Frame, unit_index: int, decalibration: Tensor | None) -> Sample:
        """A frame at the network's size and culled, with its unit and (6,) fixed decalibration.

        Raises:
            FrameError: the frame's image cannot be brought to the network's size.
        """
        camera, K = self._camera(frame)
        points = frame.points
        if frame.twist is not None:
            points = untwisted(points, frame.twist, frame.spin)
        return Sample(
            unit_index=unit_index,
            frame=frame.id,
            camera=camera,
            points=torch.from_numpy(self._in_view(points, frame, K)),
            edges=torch.from_numpy(self._edges(frame, K)),
            K=torch.from_numpy(K.astype(np.float32)),
            T_cam_lidar=torch.from_numpy(frame.T_cam_lidar.astype(np.float32)),
            decalibration=decalibration,
        )

    def _edges(self, frame: Frame, K: NDArray[np.float64]) -> NDArray[np.float32]:
        """Edges of the sweep, selected among those in view."""
        if self.edges == 0:
            return np.empty((0, len(COLUMNS)), np.float32)
        # Neighbours are neighbours in the sweep as it was measured.
        edges = find_edges(frame.points)
        if frame.twist is not None:
            edges = untwisted(edges, frame.twist, frame.spin)
        edges = self._in_view(edges, frame, K)
        return select_edges(edges, self.edges, seed=frame.id.index)

    def _in_view(
        self, points: NDArray[np.float32], frame: Frame, K: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Those that some decalibration within the range can bring into the image."""
        reach = (self.decalibration.rotation, self.decalibration.translation)
        return points[frustum_mask(points[:, :3], frame.T_cam_lidar, K, self.image_size, *reach)]

    def _camera(self, frame: Frame) -> tuple[Tensor, NDArray[np.float64]]:
        """The camera's tensor at the network's size, and the camera matrix that goes with it."""
        if frame.image is not None:
            how = self.fit((frame.image.shape[0], frame.image.shape[1]), frame.K)
            image, K = resize_and_crop(frame.image, frame.K, how, self.image_size)
            return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))), K
        if frame.events is None:
            raise FrameError("the frame has neither an image nor events")
        how = self.fit(frame.events.size, frame.K)
        K = how.camera_matrix(frame.K)
        if self.events is None:
            return torch.empty(0, *self.image_size, dtype=torch.float16), K
        drawn = self.events(frame.events, self.image_size, how.pixel_map)
        # Half precision, or the cached demo would take gigabytes; counts beyond it stay finite.
        return drawn.clamp(-_LARGEST, _LARGEST).half(), K

    def fit(self, source: tuple[int, int], K: NDArray[np.float64]) -> Fit:
        """How a sensor's image of (h, w) with the camera matrix K comes to the network's size."""
        if self.focal_px is None:
            return fit(source, self.image_size)
        return fit_focal(source, float(K[0, 0]), self.focal_px, self.image_size)


def collate(items: Sequence[Item]) -> Batch:
    """Stack the readable samples; a batch of none has B = 0.

    A window of which a frame cannot be read goes on with the others.
    """
    frames = [frame for item in items for frame in item]
    skipped = [frame for frame in frames if isinstance(frame, SkippedFrame)]
    samples = [frame for frame in frames if isinstance(frame, Sample)]
    if not samples:
        none, empty = torch.empty(0, dtype=torch.int64), torch.empty(0)
        return Batch(none, none, [], empty, empty, empty, empty, empty, None, skipped)
    indices = torch.tensor([sample.unit_index for sample in samples])
    unit_index, unit = torch.unique_consecutive(indices, return_inverse=True)
    first = [samples[i] for i in range(len(samples)) if i == 0 or unit[i] != unit[i - 1]]
    fixed = [sample.decalibration for sample in first if sample.decalibration is not None]
    return Batch(
        unit_index=unit_index,
        unit=unit,
        frames=[sample.frame for sample in samples],
        camera=torch.stack([sample.camera for sample in samples]),
        points=_padded([sample.points for sample in samples]),
        edges=_padded([sample.edges for sample in samples]),
        K=torch.stack([sample.K for sample in samples]),
        T_cam_lidar=torch.stack([sample.T_cam_lidar for sample in samples]),
        decalibration=torch.stack(fixed) if fixed else None,
        skipped=skipped,
    )


def _padded(rows: list[Tensor]) -> Tensor:
    return pad_sequence(rows, batch_first=True, padding_value=float("nan"))
