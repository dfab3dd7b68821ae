"""The LightningDataModule: four disjoint splits of one recording, decalibrated on the device."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import lightning
import torch
import torch.distributed as dist
from torch.utils.data import DataLoader, Dataset, Subset

from uncal.data.augmentation import Augmentation
from uncal.data.dataset import Batch, FrameDataset, Item, collate
from uncal.data.network_input import InputSettings, NetworkInput, make_input
from uncal.errors import RecordingError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.recordings.frame import FrameId, Recording
from uncal.splits.split_settings import SplitSettings
from uncal.splits.splits import SPLITS
from uncal.splits.windows import WindowSettings, units_of

log = logging.getLogger(__name__)

WINDOWED: tuple[str, ...] = ("uncertainty_calibration", "test")
"""Splits whose unit is a window of frames."""


@dataclass(frozen=True)
class LoaderSettings:
    """How frames reach the device.

    Attributes:
        batch_size: samples of a training batch.
        eval_batch_size: samples of a batch in the three other splits.
        workers: loading processes; 0 loads in the main process.
        cache: keep samples in memory after their first use.
    """

    batch_size: int
    eval_batch_size: int
    workers: int
    cache: bool


class CalibrationDataModule(lightning.LightningDataModule):
    """Train / validation / uncertainty calibration / test, disjoint by construction.

    Loaders yield :class:`~uncal.data.dataset.Batch`; after the transfer to the device each becomes
    a :class:`~uncal.data.network_input.NetworkInput`. In training the decalibration is drawn per
    step; elsewhere it is a pure function of (seed, frame).

    Args:
        recording: where the frames come from.
        image_size: (H, W) of the network's images, pixels.
        decalibration: the range of the artificial decalibrations.
        split: how frames are shared out.
        loader: batch sizes, workers, cache.
        inputs: channels and scales of the network's input.
        augmentation: applied to training batches.
        seed: of the fixed draws in the evaluation splits.
        window: what one estimate is made of, in uncertainty calibration and test; training and
            validation look at single frames.
        focal_px: focal length that images are brought to, pixels; None: as ``image_size`` says.

    Attributes:
        splits: split → its frames.
        units: split → its frames, unit by unit; see :mod:`uncal.splits.windows`.
        split_note: what a reader must know of the split; empty where its name says it all.
    """

    def __init__(
        self,
        recording: Recording,
        image_size: tuple[int, int],
        decalibration: DecalibrationRange,
        split: SplitSettings,
        loader: LoaderSettings,
        inputs: InputSettings,
        augmentation: Augmentation,
        seed: int,
        window: WindowSettings | None = None,
        focal_px: float | None = None,
    ) -> None:
        super().__init__()
        self.window = WindowSettings(1) if window is None else window
        self.focal_px = focal_px
        self.recording = recording
        self.image_size = image_size
        self.decalibration = decalibration
        self.loader = loader
        self.inputs = inputs
        self.augmentation = augmentation
        self.seed = seed
        self.split_by = split.by
        if not recording.frame_ids:
            raise RecordingError("the recording holds no usable frame: see the skipped ones above")
        self.splits, self.split_note = split.split(recording.frame_ids, self.window.frames)
        self.units = {
            name: units_of(
                frames, self.window.frames if name in WINDOWED else 1, recording.frame_ids
            )
            for name, frames in self.splits.items()
        }
        self.datasets = {name: self._dataset(name) for name in SPLITS}
        self.skipped: dict[str, str] = dict(recording.skipped)

    def _dataset(self, split: str) -> FrameDataset:
        return FrameDataset(
            self.recording,
            self.units[split],
            self.image_size,
            self.decalibration,
            None if split == "train" else self.seed,
            self.loader.cache,
            self.inputs.events,
            self.inputs.edges,
            self.focal_px,
        )

    def named(self, split: str) -> list[FrameId]:
        """The units of a split, each by its first frame."""
        return [unit[0] for unit in self.units[split]]

    def loader_of(
        self,
        split: str,
        most: int | None = None,
        share: tuple[int, int] = (0, 1),
        order: Sequence[int] | None = None,
    ) -> DataLoader[Batch]:
        """Batches of one split: shuffled in training, in order elsewhere.

        Args:
            split: a name of :data:`uncal.splits.splits.SPLITS`.
            most: units at most, spread evenly over the split; None: all.
            share: (rank, world size): every so many-th of them, for one of several processes.
            order: numbers of the units to load, in that order, in place of the two above.
        """
        training = split == "train"
        size = self.loader.batch_size if training else self.loader.eval_batch_size
        dataset: Dataset[Item] = self.datasets[split]
        n = len(self.units[split])
        size = max(1, size // len(self.units[split][0])) if n else size
        used = n if most is None else min(n, most)
        evenly = [i * n // used for i in range(used)][share[0] :: share[1]]
        chosen = evenly if order is None else list(order)
        if chosen != list(range(n)):
            dataset, n = Subset(dataset, chosen), len(chosen)
        return DataLoader(
            dataset,  # type: ignore[arg-type]  # collate turns samples into a Batch
            batch_size=size,
            shuffle=training,
            # A small last batch would disturb BatchNorm; it is kept if it is all there is.
            drop_last=training and n > size,
            num_workers=self.loader.workers,
            persistent_workers=self.loader.workers > 0,
            collate_fn=collate,
            pin_memory=torch.cuda.is_available(),
        )

    def train_dataloader(self) -> DataLoader[Batch]:
        """Shuffled training batches."""
        return self.loader_of("train")

    def val_dataloader(self) -> DataLoader[Batch]:
        """Validation batches, in order."""
        return self.loader_of("validation")

    def uncertainty_calibration_dataloader(self) -> DataLoader[Batch]:
        """Batches of the uncertainty calibration split, in order."""
        return self.loader_of("uncertainty_calibration")

    def test_dataloader(self) -> DataLoader[Batch]:
        """Test batches, in order."""
        return self.loader_of("test")

    def predict_dataloader(self) -> DataLoader[Batch]:
        """What ``trainer.predict`` looks at: the test batches."""
        return self.loader_of("test")

    def share_skipped(self) -> None:
        """Let every process know what the others skipped."""
        if dist.is_available() and dist.is_initialized():
            everywhere: list[dict[str, str]] = [{} for _ in range(dist.get_world_size())]
            dist.all_gather_object(everywhere, self.skipped)
            for skipped in everywhere:
                self.skipped.update(skipped)

    def on_after_batch_transfer(self, batch: Batch, dataloader_idx: int) -> NetworkInput | None:
        """Decalibrate and project on the device; None where no frame of the batch could be read."""
        for skipped in batch.skipped:
            if str(skipped.frame) not in self.skipped:
                log.warning("skipped %s: %s", skipped.frame, skipped.reason)
            self.skipped[str(skipped.frame)] = skipped.reason
        if not batch.frames:
            return None
        decalibration = batch.decalibration
        if decalibration is None:
            batch = self.augmentation(batch)
            decalibration = self.decalibration.draw(len(batch.unit_index), batch.camera.device)
        return make_input(batch, decalibration, self.inputs)
