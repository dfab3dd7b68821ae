"""One walk over trusted frames that serves both the calibration and the monitor's references."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from torch.utils.data import DataLoader, Dataset

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Batch, FrameDataset, Item, Sample, SkippedFrame, collate
from uncal.errors import FrameError
from uncal.recordings.frame import Frame, FrameId, Recording
from uncal.system.progress import watched

Take = Callable[[FrameId, "Frame | FrameError"], None]
"""Is given every frame of a recording, or why it cannot be read."""


class _Read(NamedTuple):
    """A frame, and what the calibration makes of it; neither of them where it cannot be read."""

    frame_id: FrameId
    frame: Frame | FrameError
    unit: int | None  # of the split; None: the frame is not in it
    sample: Sample | SkippedFrame | None


class _Frames(Dataset[_Read]):
    """Every frame of a recording, read once.

    Args:
        recording: of the frames.
        dataset: of the split, which makes samples.
    """

    def __init__(self, recording: Recording, dataset: FrameDataset) -> None:
        self.recording = recording
        self.dataset = dataset
        self.unit = {frame: i for i, unit in enumerate(dataset.units) for frame in unit}

    def __len__(self) -> int:
        return len(self.recording.frame_ids)

    def __getitem__(self, index: int) -> _Read:
        frame_id = self.recording.frame_ids[index]
        unit = self.unit.get(frame_id)
        try:
            frame = self.recording.load(frame_id)
        except FrameError as error:
            skipped = None if unit is None else SkippedFrame(frame_id, str(error))
            return _Read(frame_id, error, unit, skipped)
        return _Read(
            frame_id, frame, unit, None if unit is None else self.dataset.of_frame(frame, unit)
        )


def batches_of_one_walk(
    data: CalibrationDataModule, split: str, take: Take, what: str
) -> Iterator[Batch]:
    """The batches of ``data.loader_of(split)``, while ``take`` is given every frame, in order.

    Args:
        data: splits of a recording.
        split: the one whose batches are wanted.
        take: also of the frames that are in other splits.
        what: name of the progress bar.
    """
    dataset, units = data.datasets[split], data.units[split]
    size = data.loader_of(split).batch_size or 1
    reader = DataLoader(
        _Frames(data.recording, dataset),
        batch_size=None,
        num_workers=data.loader.workers,
        collate_fn=_as_it_is,
    )
    unfinished: dict[int, Item] = {}
    finished: list[Item] = []
    n_units = 0
    for read in watched(reader, what):
        take(read.frame_id, read.frame)
        if read.unit is None or read.sample is None:
            continue
        unfinished.setdefault(read.unit, []).append(read.sample)
        while n_units < len(units) and len(unfinished.get(n_units, [])) == len(units[n_units]):
            finished.append(unfinished.pop(n_units))
            n_units += 1
            if len(finished) == size or n_units == len(units):
                yield collate(finished)
                finished = []


def _as_it_is(read: Any) -> Any:  # noqa: ANN401
    """Not turned into tensors, as the loader would."""
    return read
