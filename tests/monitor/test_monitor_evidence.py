"""Evidence of single frames is what the module itself estimates from."""

from __future__ import annotations

from collections import Counter
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from uncal.data.dataset import collate
from uncal.data.network_input import make_input
from uncal.edges.evidence import pack, unpack
from uncal.models.alignment import PRIOR, AlignmentEstimator
from uncal.monitor.equations import beyond
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.references import fingerprint
from uncal.monitor.settings import MonitorSettings
from uncal.recordings.frame import Frame, FrameId
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import save_weights
from uncal.settings.shipped import shipped_config

T = np.array([[0.0, -1, 0, 0.05], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
K = np.array([[230.0, 0.0, 103.5], [0.0, 230.0, 39.5], [0.0, 0.0, 1.0]])


@pytest.fixture
def reader(tmp_path: Path) -> EvidenceReader:
    config = shipped_config("train", {})
    config.mcd.passes = 3
    torch.manual_seed(0)
    save_weights(build_module(config), tmp_path / "untrained.ckpt")
    return EvidenceReader(tmp_path / "untrained.ckpt", torch.device("cpu"), seed=0)


@pytest.fixture
def frame() -> Frame:
    """Boxes of noise before a wall: depth edges, at azimuths and elevations of a LiDAR."""
    rng = np.random.default_rng(0)
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(4, -12, 32)), np.radians(np.arange(30, -30, -0.25)), indexing="ij"
    )
    depth = np.where((np.degrees(azimuth) // 6) % 2 == 0, 8.0, 14.0)
    direction = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        -1,
    )
    points = np.concatenate([direction * depth[..., None], np.full((*depth.shape, 1), 0.5)], -1)
    image = rng.integers(0, 256, (80, 208, 3), dtype=np.uint8)
    flat = points.reshape(-1, 4).astype(np.float32)
    return Frame(FrameId("rig", "drive", 0), image, flat, K, T, 0.0)


@pytest.mark.parametrize("name", ["reaches", "rounds", "start"])
def test_references_belong_to_the_rounds_and_the_start(
    reader: EvidenceReader, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    settings = MonitorSettings.shipped()
    before = fingerprint(reader, settings)
    model = reader.module.recipe["model"]
    assert isinstance(model, dict)
    monkeypatch.setitem(model, name, [1])
    after = fingerprint(reader, settings)
    assert {key for key in before if before[key] != after[key]} == {"estimator"}


def test_with_its_prior_a_frame_says_what_the_module_estimates(
    reader: EvidenceReader, frame: Frame
) -> None:
    estimator = reader.module.estimator
    assert isinstance(estimator, AlignmentEstimator)
    assert estimator.start is not None
    sample = reader.prepare(frame, T)
    assert len(sample.edges) > 100
    counted = reader.read(sample)
    reader.counts_start = False
    evidence = reader.read(sample)
    with torch.inference_mode():
        inputs = make_input(collate([[sample]]), torch.zeros(1, 6), reader.inputs)
        expected = reader.module.stochastic(inputs, "monitor")
    found = reader.solve(evidence.equations, evidence.prior)
    assert found.mean / reader.bounds == pytest.approx(
        expected.mean[0].numpy() / reader.bounds, abs=1e-3
    )
    assert found.std == pytest.approx(expected.std[0].numpy(), rel=1e-3)
    # Without it, the weights' own calibration would be of another estimator.
    other = reader.solve(evidence.equations)
    assert np.abs(other.std / expected.std[0].numpy() - 1).max() > 1e-3
    # As evidence, for windows: what the start knows beyond the uniform prior, about its own mean.
    assert counted.prior is None
    assert evidence.prior is not None
    known = beyond(evidence.prior.precision[0], PRIOR / estimator.start_inflation)
    normal, right = unpack(counted.equations - evidence.equations)
    scale = float(known.abs().max()) + 1.0
    assert (normal - known).abs().max() < 1e-3 * scale
    assert (right - known @ evidence.prior.mean[0]).abs().max() < 1e-3 * scale


def test_what_is_shared_is_what_would_be_computed_again(
    reader: EvidenceReader, frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimator = reader.module.estimator
    assert isinstance(estimator, AlignmentEstimator)
    network, start = estimator.last.network, estimator.start
    assert start is not None
    counts: Counter[str] = Counter()

    def counted(owner: nn.Module, name: str) -> None:
        function = getattr(owner, name)

        def call(*args: object) -> object:
            counts[name] += 1
            return function(*args)

        monkeypatch.setattr(owner, name, call)

    counted(network, "describe")
    counted(start, "align")
    sample = reader.prepare(frame, T)
    reader.read(sample)  # the first one tries strategies
    counts.clear()
    shared = reader.read(sample)
    assert counts == {"describe": 1, "align": 1}
    counts.clear()
    monkeypatch.setattr("uncal.monitor.equations.computed_once", lambda _: nullcontext())
    again = reader.read(sample)
    assert counts == {"describe": 3, "align": 2}
    assert torch.equal(shared.equations, again.equations)
    np.testing.assert_array_equal(shared.statistics, again.statistics)


def test_information_beyond_a_prior_is_never_negative() -> None:
    information = torch.diag(torch.tensor([5.0, 4.0, 3.0, 2.0, 1.0, 9.0]))
    expected = torch.diag(torch.tensor([2.0, 1.0, 0.0, 0.0, 0.0, 6.0]))
    torch.testing.assert_close(beyond(information, 3.0), expected)


def test_a_step_taken_out_is_what_the_rebased_evidence_no_longer_finds(
    reader: EvidenceReader,
) -> None:
    root = torch.randn(6, 6, generator=torch.Generator().manual_seed(0))
    normal = 1e4 * (root @ root.T + torch.eye(6))  # so much that the prior hardly counts
    truth = torch.tensor([0.5, -0.4, 0.3, -0.2, 0.1, 0.6])
    equations = pack(normal, normal @ truth)[None].expand(3, 27)
    assert reader.solve(equations).mean / reader.bounds == pytest.approx(truth.numpy(), abs=1e-2)
    step = np.array([0.2, 0.0, 0.3, 0.1, -0.1, 0.4]) * reader.bounds
    after = reader.solve(reader.rebase(equations, step)).mean
    assert after / reader.bounds == pytest.approx(truth.numpy() - step / reader.bounds, abs=1e-2)
