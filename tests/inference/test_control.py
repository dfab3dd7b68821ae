"""The image-blind control on a recording whose images say the answer, and on networks made by hand.

The stripes of an image show the frame's decalibration, so that a network that reads the image
alone is right with its own image, and estimates another frame's decalibration with that one's.
"""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import lightning
import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch import distributed as dist
from torch.multiprocessing.spawn import spawn

from uncal.data.augmentation import Augmentation
from uncal.data.datamodule import CalibrationDataModule, LoaderSettings
from uncal.data.network_input import InputSettings
from uncal.errors import FrameError
from uncal.events.representations import Histogram
from uncal.events.stream import Events
from uncal.geometry import DOF_NAMES
from uncal.geometry.decalibration import DecalibrationRange
from uncal.inference.split_passes import control_order, image_blind_control
from uncal.models.estimator import PoseEstimator
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import ControlPrediction
from uncal.recordings.frame import Frame, FrameId
from uncal.splits.split_settings import SplitSettings
from uncal.splits.windows import units_of
from uncal.uncertainty import ConformalCalibrator, MCDropout

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
SIZE = (8, 12)
SEED = 3
K = np.array([[9.0, 0.0, 5.5], [0.0, 9.0, 3.5], [0.0, 0.0, 1.0]])
T = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


class Telling:
    """Frames whose image, or events, show the decalibration; some cannot be read."""

    skipped: dict[str, str]

    def __init__(self, n: int, unreadable: set[int], events: bool) -> None:
        self.frame_ids = [FrameId("rig", f"drive{i % 2}", i) for i in range(n)]
        self.unreadable = unreadable
        self.events = events
        self.skipped = {}
        self.loads = 0

    def load(self, frame_id: FrameId) -> Frame:
        self.loads += 1
        if frame_id.index in self.unreadable:
            raise FrameError("truncated")
        random = np.random.default_rng(frame_id.index)
        points = random.uniform([2, -3, -2, 0], [30, 3, 2, 1], (40, 4)).astype(np.float32)
        unit = (RANGE.draw_for(SEED, str(frame_id)) / RANGE.bounds).numpy()
        level = np.rint(127.5 + 127.5 * unit.repeat(2)).astype(int)
        if not self.events:
            image = np.broadcast_to(level[None, :, None], (*SIZE, 3)).astype(np.uint8)
            return Frame(frame_id, image, points, K, T, 0.0)
        x = np.arange(SIZE[1]).repeat(level).astype(np.float32)
        t = np.linspace(0, 999, len(x)).astype(np.int64)
        sign = np.ones(len(x), dtype=bool)
        events = Events(x, np.full_like(x, 4), t, sign, (0, 1000), SIZE)
        return Frame(frame_id, None, points, K, T, 0.0, events=events)


class Reader(nn.Module):
    """Reads the stripes of the camera, or the mean of the points, or both."""

    def __init__(self, camera: float, points: float) -> None:
        super().__init__()
        self.weights = (camera, points)
        self.norm = nn.BatchNorm1d(6)
        self.dropout = nn.Dropout(0.5)

    def forward(self, x: Tensor) -> Tensor:
        stripes = x[:, :-2].amax((1, 2)).reshape(len(x), 6, 2).mean(2) * 2 - 1
        seen = x[:, -2:].mean((1, 2, 3))[:, None] - 0.1
        camera, points = self.weights
        return cast(Tensor, self.dropout(self.norm(camera * stripes + points * seen)))


def module(network: nn.Module) -> CalibrationModule:
    made = CalibrationModule(
        estimator=PoseEstimator(
            network,
            RANGE.bounds,
            ridge=0.1,
            displacement_weight=0.5,
            quantile_levels=(0.05, 0.95),
        ),
        optimizer=lambda parameters: torch.optim.SGD(parameters, lr=1.0),
        warmup_fraction=0.1,
        engine=lambda network, masks: MCDropout(network, 4, masks=masks),
        spread="dropout",
        fixed_masks=False,
        calibrator=ConformalCalibrator(DOF_NAMES, 1e-9),
        groups="rig",
        mask_seed=0,
    )
    for layer in made.modules():
        if isinstance(layer, nn.BatchNorm1d):
            layer.eps = 0.0  # or it would not be the identity that it starts as
    return made


def data(
    n: int,
    batch: int = 3,
    unreadable: set[int] | None = None,
    events: bool = False,
    workers: int = 0,
) -> CalibrationDataModule:
    """All n frames are the test split."""
    recording = Telling(max(n, 4), unreadable or set(), events)
    made = CalibrationDataModule(
        recording=recording,
        image_size=SIZE,
        decalibration=RANGE,
        split=SplitSettings("frame", (0.25, 0.25, 0.25, 0.25), seed=0),
        loader=LoaderSettings(batch_size=2, eval_batch_size=batch, workers=workers, cache=False),
        inputs=InputSettings(
            channels=["events" if events else "rgb", "inverse_depth", "intensity"],
            inverse_depth_scale=1.0,
            intensity_scale=1.0,
            camera_channels=2 if events else 3,
            events=Histogram(normalize=False) if events else None,
            events_scale=1 / 255,
        ),
        augmentation=Augmentation(mirror=1.0, brightness=0.5, contrast=0.5),
        seed=SEED,
    )
    units = units_of(recording.frame_ids[:n], 1)
    made.datasets["test"].units = units
    made.splits = {**made.splits, "test": recording.frame_ids[:n]}
    made.units = {**made.units, "test": units}
    return made


def trainer(rank: int = 0, processes: int = 1, precision: str = "32-true") -> lightning.Trainer:
    """What the control needs of one, without starting processes."""
    real = lightning.Trainer(
        accelerator="cpu",
        precision=precision,  # type: ignore[arg-type]
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
    )
    fake = SimpleNamespace(
        global_rank=rank,
        world_size=processes,
        is_global_zero=rank == 0,
        precision_plugin=real.precision_plugin,
    )
    return cast(lightning.Trainer, fake)


def control(subject: CalibrationDataModule, camera: float, points: float) -> ControlPrediction:
    found = image_blind_control(trainer(), module(Reader(camera, points)), subject)
    assert found is not None
    return found


def donors(found: ControlPrediction) -> dict[int, int]:
    """Frame → the frame whose image it was given, as the network that reads it shows."""
    given = {}
    for index, blind in zip(found.index.tolist(), found.blind, strict=True):
        # Another place in a batch may change the last bit of a mean.
        near = ((found.single - blind).abs() <= 1e-6 * RANGE.bounds).all(1)
        assert int(near.sum()) == 1
        given[index] = int(found.index[near])
    return given


def cycle(order: list[int]) -> dict[int, int]:
    return dict(zip(order, [order[-1], *order[:-1]], strict=True))


def contribution(found: ControlPrediction) -> Tensor:
    errors = [(found.target - each).abs().mean(0) for each in (found.single, found.blind)]
    return (errors[1] - errors[0]) / found.target.abs().mean(0)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 7])
@pytest.mark.parametrize("batch", [1, 2, 3, 100])
@pytest.mark.parametrize("events", [False, True])
def test_each_frame_gets_the_image_of_the_one_before_it(n: int, batch: int, events: bool) -> None:
    subject = data(n, batch, events=events)
    found = control(subject, camera=1.0, points=0.0)
    assert found.index.tolist() == list(range(n))
    assert list(found.frames) == subject.splits["test"]
    # The network is right with the frame's own image: the stripes have 8 bits.
    assert ((found.single - found.target).abs() <= RANGE.bounds / 200).all()
    assert donors(found) == cycle(control_order(subject.splits["test"], SEED))


@pytest.mark.parametrize("batch", [1, 2, 3, 100])
@pytest.mark.parametrize("readable", [[0, 1], [2, 5], [1, 2, 3], [0, 2, 4, 6], [0, 1, 2, 5, 6]])
def test_unreadable_frames_drop_out_of_the_cycle(readable: list[int], batch: int) -> None:
    subject = data(7, batch, unreadable=set(range(7)) - set(readable))
    found = control(subject, camera=1.0, points=0.0)
    assert found.index.tolist() == readable
    order = control_order(subject.splits["test"], SEED)
    assert donors(found) == cycle([i for i in order if i in readable])
    assert len(subject.skipped) == 7 - len(readable)


@pytest.mark.parametrize("readable", [[], [4]])
def test_fewer_than_two_frames_have_no_control(
    readable: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    subject = data(6, unreadable=set(range(6)) - set(readable))
    with caplog.at_level(logging.WARNING):
        assert image_blind_control(trainer(), module(Reader(1.0, 0.0)), subject) is None
    assert "fewer than two of the 6 frames of the test split" in caplog.text
    for process in range(3):
        assert image_blind_control(trainer(process, 3), module(Reader(1.0, 0.0)), subject) is None


def test_a_network_that_reads_points_alone_owes_the_camera_nothing() -> None:
    found = control(data(9), camera=0.0, points=1.0)
    assert torch.equal(found.single, found.blind)
    assert contribution(found).tolist() == [0.0] * 6
    assert found.single.std(0).min() > 0


def test_a_network_without_a_camera_channel_has_a_control_too() -> None:
    subject = data(5)
    subject.inputs = InputSettings(
        channels=["inverse_depth"], inverse_depth_scale=1.0, intensity_scale=1.0
    )

    class Depth(nn.Module):
        def forward(self, x: Tensor) -> Tensor:
            return x.mean((1, 2, 3))[:, None].expand(len(x), 6)

    found = image_blind_control(trainer(), module(Depth()), subject)
    assert found is not None
    assert torch.equal(found.single, found.blind)


def test_a_network_that_reads_the_image_owes_it_all() -> None:
    # Two independent draws from ±1 are 2/3 apart on average, one is 1/2 from 0: 133 %.
    found = control(data(400, batch=64), camera=1.0, points=0.0)
    assert contribution(found).tolist() == pytest.approx([4 / 3] * 6, abs=0.15)


def test_the_points_are_the_frames_own() -> None:
    subject = data(8)
    both, image = control(subject, 1.0, 1.0), control(subject, 1.0, 0.0)
    points = control(subject, 0.0, 1.0)
    torch.testing.assert_close(both.blind, image.blind + points.single, rtol=1e-4, atol=1e-7)
    assert torch.equal(both.target, points.target)


def test_batches_and_processes_and_workers_change_nothing() -> None:
    expected = control(data(11, batch=4), 0.7, 0.4)
    for batch, workers in ((1, 0), (2, 1), (11, 0)):
        found = control(data(11, batch, workers=workers), 0.7, 0.4)
        for a, b in zip(columns(found), columns(expected), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-8)
    for processes in (2, 3, 13):
        parts = [
            image_blind_control(
                trainer(rank, processes), module(Reader(0.7, 0.4)), data(11, 2, {0, 6})
            )
            for rank in range(processes)
        ]
        joined = [torch.cat(each) for each in zip(*map(columns, filter(None, parts)), strict=True)]
        order = joined[0].argsort()
        alone = control(data(11, 2, {0, 6}), 0.7, 0.4)
        for a, b in zip(joined, columns(alone), strict=True):
            torch.testing.assert_close(a[order], b, rtol=1e-5, atol=1e-8)


def columns(found: ControlPrediction | None) -> list[Tensor]:
    assert found is not None
    return [found.index, found.single, found.blind, found.target]


def test_every_frame_is_loaded_once_and_one_more() -> None:
    subject = data(10, batch=3)
    control(subject, 1.0, 0.0)
    assert cast(Telling, subject.recording).loads == 11


def test_dropout_is_off_and_the_modules_flags_are_put_back() -> None:
    subject, network = data(6), Reader(1.0, 1.0)
    asleep = module(network).eval()
    expected = image_blind_control(trainer(), asleep, subject)
    assert not any(layer.training for layer in asleep.modules())
    awake = asleep.train()
    network.norm.eval()  # frozen by its owner: stays so
    found = image_blind_control(trainer(), awake, subject)
    for a, b in zip(columns(found), columns(expected), strict=True):
        assert torch.equal(a, b)
    assert network.dropout.training
    assert not network.norm.training


def test_the_trainers_precision_is_used() -> None:
    class Kinds(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.linear = nn.Linear(1, 6)
            self.seen: set[torch.dtype] = set()

        def forward(self, x: Tensor) -> Tensor:
            y: Tensor = self.linear(x.mean((1, 2, 3))[:, None])
            self.seen.add(y.dtype)
            return y

    network = Kinds()
    found = image_blind_control(trainer(precision="bf16-mixed"), module(network), data(4))
    assert network.seen == {torch.bfloat16}
    assert found is not None
    assert {each.dtype for each in (found.single, found.blind, found.target)} == {torch.float32}


def test_the_order_is_not_that_of_time_and_follows_seed_and_names() -> None:
    frames = [FrameId("rig", "drive", i) for i in range(200)]
    order = control_order(frames, seed=0)
    assert sorted(order) == list(range(200))
    given = cycle(order)
    assert sum(abs(frame - donor) == 1 for frame, donor in given.items()) < 10
    assert order == control_order(frames, seed=0)
    assert order != control_order(frames, seed=1)
    # A frame keeps its rank among others if some of them leave the split.
    some = [frames[i] for i in range(0, 200, 3)]
    named = [frames[i] for i in order if i % 3 == 0]
    assert [some[i] for i in control_order(some, seed=0)] == named


def test_training_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="not of train"):
        image_blind_control(trainer(), module(Reader(1.0, 0.0)), data(4), "train")


def test_the_part_among_some_frames() -> None:
    found = control(data(6), 0.5, 0.5)
    part = found.among(torch.tensor([4, 1, 77]))
    assert part is not None
    assert part.index.tolist() == [1, 4]
    assert part.frames == (found.frames[1], found.frames[4])
    assert torch.equal(part.blind, found.blind[[1, 4]])
    assert found.among(torch.tensor([3])) is None


READABLE = {"all": set[int](), "one is left": {0, 1, 3, 4}, "none is left": {0, 1, 2, 3, 4}}


def _work(rank: int, folder: str) -> None:
    dist.init_process_group("gloo", init_method=f"file://{folder}/init", rank=rank, world_size=2)
    torch.set_num_threads(1)
    results = {}
    for name, unreadable in READABLE.items():
        subject = data(5, 2, unreadable)
        found = image_blind_control(trainer(rank, 2), module(Reader(0.7, 0.4)), subject)
        results[name] = (None if found is None else columns(found), sorted(subject.skipped))
    torch.save(results, Path(folder) / f"{rank}.pt")
    dist.destroy_process_group()


@pytest.mark.slow
def test_two_processes_give_what_one_gives(tmp_path: Path) -> None:
    spawn(_work, args=(str(tmp_path),), nprocs=2)  # type: ignore[no-untyped-call]
    for rank in range(2):
        results = torch.load(tmp_path / f"{rank}.pt")
        for a, b in zip(results["all"][0], columns(control(data(5), 0.7, 0.4)), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-8)
        assert results["one is left"][0] is None
        assert results["none is left"][0] is None
        assert [len(results[name][1]) for name in READABLE] == [0, 4, 5]
