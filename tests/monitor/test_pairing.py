"""Whether sweeps fit other images better than their own, and frames the window that they are in."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from uncal.edges.evidence import pack
from uncal.edges.sweep import COLUMNS
from uncal.monitor.evidence import Evidence
from uncal.monitor.pairing import Glimpse, PairingCheck, fit
from uncal.monitor.statistics import STATISTICS
from uncal.monitor.window import Window

HEIGHT, WIDTH, FOCAL = 40, 104, 100.0
K = torch.tensor([[[FOCAL, 0.0, 51.5], [0.0, FOCAL, 19.5], [0.0, 0.0, 1.0]]])
T = torch.eye(4)[None]


def frame(number: int, noise: int = 0) -> Glimpse:
    """Two hundred edges, at depth 10 in the camera's frame, and an image that is strong there."""
    rng = torch.Generator().manual_seed(number)
    pixels = torch.stack(
        [torch.randint(2, WIDTH - 2, (200,), generator=rng),
         torch.randint(2, HEIGHT - 2, (200,), generator=rng)], -1
    )  # fmt: skip
    strength = torch.rand(1, 2, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(noise))
    strength[0, :, pixels[:, 1], pixels[:, 0]] = 3.0
    edges = torch.zeros(1, 200, len(COLUMNS))
    edges[0, :, :2] = (pixels - K[0, :2, 2]) / FOCAL * 10.0
    edges[0, :, 2] = 10.0
    strength = (strength - strength.mean((2, 3), keepdim=True)) / strength.std()
    return Glimpse(strength, edges, torch.ones(1, 200), K)


def with_sweeps(images: list[int], sweeps: list[int]) -> Iterator[Glimpse]:
    for image, sweep in zip(images, sweeps, strict=True):
        yield frame(sweep)._replace(strength=frame(image).strength)


def test_fit_is_zero_by_chance() -> None:
    own, other = float(fit(frame(1), frame(1), T)), float(fit(frame(1), frame(2), T))
    assert own > 2.0
    assert abs(other) < 0.5
    # An extrinsic that leads elsewhere fits no better than another sweep.
    moved = T.clone()
    moved[0, 0, 3] = 0.5
    assert abs(float(fit(frame(1), frame(1), moved))) < 0.5
    assert float(fit(frame(1), frame(1), torch.cat([moved, T])).max()) == pytest.approx(own)


@pytest.mark.parametrize(
    ("images", "sweeps", "first"),
    [
        ([0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5], None),
        ([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], None),
        ([0, 1, 2, 3, 4, 5], [0, 1, 3, 2, 5, 4], 4),  # swapped two by two
        ([0, 1, 1, 2, 3, 4], [0, 1, 2, 3, 4, 5], 3),  # the camera's clock is late
        ([0, 1, 2, 3, 4, 5], [0, 1, 0, 1, 2, 3], 3),  # the LiDAR's, by two frames
    ],
)
def test_wrong_pairings_are_doubted(
    images: list[int], sweeps: list[int], first: int | None
) -> None:
    check = PairingCheck(0.1)
    doubts = [check.doubt(seen, T) for seen in with_sweeps(images, sweeps)]
    told = [number for number, doubt in enumerate(doubts) if doubt is not None]
    assert (told[0] if told else None) == first
    check.clear()
    assert check.doubt(frame(9), T) is None


def evidence(pose: float, information: float = 1e4) -> Evidence:
    equations = pack(information * torch.eye(6), information * pose * torch.ones(6))
    return Evidence(equations.expand(3, 27), np.zeros(len(STATISTICS)))


def window(*poses: float) -> Window:
    made = Window(8, 1.0)
    for pose in poses:
        made.add(evidence(pose))
    return made


def test_two_frames_in_a_row_contradict_a_window() -> None:
    # d = 0.02; variance 1e-4 of a frame, a quarter of it of four: 4e-4 / 1.25e-4.
    assert window(0, 0, 0, 0, 0.02, 0.02).jump() == pytest.approx(3.2, rel=1e-2)
    assert window(0, 0, 0, 0, 0.02, 0.0).jump() == pytest.approx(0.0, abs=1e-6)
    assert window(0, 0.5, 0.5).jump() == 0.0
    changed = window(0, 0, 0, 0, 0.02, 0.02)
    changed.keep_last(2)
    assert [entry.number for entry in changed.entries] == [5, 6]
