"""Frames to samples and samples to batches: the part of the work that workers do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from uncal.data.culling import frustum_mask
from uncal.data.image_size import fit, resize_and_crop
from uncal.decalibration import DecalibrationRange
from uncal.errors import FrameError
from uncal.events.representations import EventRepresentation
from uncal.recordings.frame import Frame, FrameId, Recording

_LARGEST = torch.finfo(torch.float16).max


class Sample(NamedTuple):
    """One frame, ready to be batched.

    Attributes:
        place: its number in the split.
        frame: its name.
        camera: (3, H, W) uint8 RGB, or (C, H, W) float16 events as their representation draws them.
        points: (n, 4) float32 culled sweep, LiDAR frame, metres and reflectance.
        K: (3, 3) float32 camera matrix at this size.
        T_cam_lidar: (4, 4) float32 true extrinsic.
        decalibration: (6,) fixed draw of the evaluation splits, or None where training draws anew.
    """

    place: int
    frame: FrameId
    camera: Tensor
    points: Tensor
    K: Tensor
    T_cam_lidar: Tensor
    decalibration: Tensor | None


class SkippedFrame(NamedTuple):
    """A frame that could not be read, and why."""

    frame: FrameId
    reason: str


class Batch(NamedTuple):
    """Samples stacked; sweeps are padded to the longest with rows of NaN, which nothing sees.

    Attributes:
        place: (B,) int64 numbers of the frames in their split.
        frames: the B frames.
        camera: (B, 3, H, W) uint8 RGB, or (B, C, H, W) float16 events.
        points: (B, N, 4) float32, LiDAR frame.
        K: (B, 3, 3) float32.
        T_cam_lidar: (B, 4, 4) float32 true extrinsics.
        decalibration: (B, 6), or None where training draws anew.
        skipped: frames left out because they could not be read.
    """

    place: Tensor
    frames: list[FrameId]
    camera: Tensor
    points: Tensor
    K: Tensor
    T_cam_lidar: Tensor
    decalibration: Tensor | None
    skipped: list[SkippedFrame]

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Batch:
        """Move the tensors; Lightning calls it for every batch.

        Args:
            device: where to.
            non_blocking: do not wait for the copies.

        Returns:
            The batch on that device.
        """
        return self._map(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Batch:
        """Pin the tensors; the DataLoader calls it where there is a GPU."""
        return self._map(Tensor.pin_memory)

    def _map(self, function: Callable[[Tensor], Tensor]) -> Batch:
        fixed = self.decalibration
        return self._replace(
            place=function(self.place),
            camera=function(self.camera),
            points=function(self.points),
            K=function(self.K),
            T_cam_lidar=function(self.T_cam_lidar),
            decalibration=None if fixed is None else function(fixed),
        )


class FrameDataset(Dataset["Sample | SkippedFrame"]):
    """Loads the frames of one split, at the network's size and culled.

    Points that no decalibration within the range can bring into the image are left out here, so
    that they are neither copied nor projected; see :mod:`uncal.data.culling`.

    Args:
        recording: where the frames come from.
        frame_ids: the frames of this split.
        image_size: (H, W) of the network's images, pixels.
        decalibration: the range that culling must respect and fixed draws come from.
        fixed_seed: evaluation splits: the decalibration is a pure function of it and the frame's
            name; None: training, which draws per step on the device.
        cache: keep samples in memory after their first use.
        events: draws the events of an event camera; None where no channel shows them.
    """

    def __init__(
        self,
        recording: Recording,
        frame_ids: Sequence[FrameId],
        image_size: tuple[int, int],
        decalibration: DecalibrationRange,
        fixed_seed: int | None,
        cache: bool,
        events: EventRepresentation | None = None,
    ) -> None:
        self.recording = recording
        self.frame_ids = list(frame_ids)
        self.image_size = image_size
        self.decalibration = decalibration
        self.fixed_seed = fixed_seed
        self.events = events
        self._cache: dict[int, Sample | SkippedFrame] | None = {} if cache else None

    def __len__(self) -> int:
        """Number of frames, readable or not."""
        return len(self.frame_ids)

    def __getitem__(self, index: int) -> Sample | SkippedFrame:
        """Load one frame; one that cannot be read comes back as :class:`SkippedFrame`."""
        if self._cache is None:
            return self._load(index)
        if index not in self._cache:
            self._cache[index] = self._load(index)
        return self._cache[index]

    def _load(self, index: int) -> Sample | SkippedFrame:
        frame_id = self.frame_ids[index]
        try:
            frame = self.recording.load(frame_id)
            camera, K = self._camera(frame)
        except FrameError as error:
            return SkippedFrame(frame_id, str(error))
        near = frustum_mask(
            frame.points[:, :3],
            frame.T_cam_lidar,
            K,
            self.image_size,
            self.decalibration.rotation,
            self.decalibration.translation,
        )
        fixed = None
        if self.fixed_seed is not None:
            fixed = self.decalibration.draw_for(self.fixed_seed, str(frame_id))
        return Sample(
            place=index,
            frame=frame_id,
            camera=camera,
            points=torch.from_numpy(frame.points[near]),
            K=torch.from_numpy(K.astype(np.float32)),
            T_cam_lidar=torch.from_numpy(frame.T_cam_lidar.astype(np.float32)),
            decalibration=fixed,
        )

    def _camera(self, frame: Frame) -> tuple[Tensor, NDArray[np.float64]]:
        """The camera's tensor at the network's size, and the camera matrix that goes with it."""
        if frame.image is not None:
            image, K = resize_and_crop(frame.image, frame.K, self.image_size)
            return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))), K
        if frame.events is None:
            raise FrameError("the frame has neither an image nor events")
        how = fit(frame.events.size, self.image_size)
        K = how.camera_matrix(frame.K)
        if self.events is None:
            return torch.empty(0, *self.image_size, dtype=torch.float16), K
        drawn = self.events(frame.events, self.image_size, how.pixel_map)
        # Half precision, or the cached demo would take gigabytes; counts beyond it stay finite.
        return drawn.clamp(-_LARGEST, _LARGEST).half(), K


def collate(items: Sequence[Sample | SkippedFrame]) -> Batch:
    """Stack the readable samples; a batch of none has B = 0.

    Args:
        items: what :class:`FrameDataset` returned.

    Returns:
        The batch, with the unreadable frames in ``skipped``.
    """
    skipped = [item for item in items if isinstance(item, SkippedFrame)]
    samples = [item for item in items if isinstance(item, Sample)]
    if not samples:
        empty = torch.empty(0)
        return Batch(empty.long(), [], empty, empty, empty, empty, None, skipped)
    longest = max(len(sample.points) for sample in samples)
    points = torch.full((len(samples), longest, 4), float("nan"))
    for row, sample in zip(points, samples, strict=True):
        row[: len(sample.points)] = sample.points
    fixed = [sample.decalibration for sample in samples if sample.decalibration is not None]
    return Batch(
        place=torch.tensor([sample.place for sample in samples]),
        frames=[sample.frame for sample in samples],
        camera=torch.stack([sample.camera for sample in samples]),
        points=points,
        K=torch.stack([sample.K for sample in samples]),
        T_cam_lidar=torch.stack([sample.T_cam_lidar for sample in samples]),
        decalibration=torch.stack(fixed) if fixed else None,
        skipped=skipped,
    )
