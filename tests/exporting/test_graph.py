"""The exported graph against the module that it is made of."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch._inductor.decomposition import decompositions
from torch.nn import functional as F

from uncal.data.network_input import InputSettings, NetworkInput
from uncal.edges.sweep import COLUMNS, find_edges
from uncal.errors import ConfigurationError
from uncal.exporting.edges_file import edges_source
from uncal.exporting.graph import AlignmentGraph
from uncal.exporting.operators import onnx_operators, torch_operators
from uncal.exporting.writer import example, to_inductor, to_torch, write_graph
from uncal.models.edge_alignment import EdgeAlignmentEstimator
from uncal.models.module import CalibrationModule
from uncal.models.operators import Operators
from uncal.recordings.frame import FrameId
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.uncertainty import ConformalCalibrator, HierarchicalCalibrator
from uncal.weights.shipped import find_weights

SIZE = (64, 160)
LEVELS = [0.9, 0.95]
INPUTS = InputSettings(
    channels=["rgb"], inverse_depth_scale=1.0, intensity_scale=1.0, rgb_mean=0.45, rgb_std=0.225
)


@pytest.fixture(scope="module")
def module() -> CalibrationModule:
    """The shipped network with fixed masks, fewer rounds and passes."""
    path = find_weights("unical")
    recipe = read_recipe(path)
    recipe.mcd.masks, recipe.mcd.passes, recipe.model.rounds = "fixed", 4, [2, 1]
    recipe.model.start.search.samples = 64
    module = build_module(recipe)
    load_weights(module, path, calibrated=True)
    module.eval()
    return module


@pytest.fixture
def short(module: CalibrationModule, monkeypatch: pytest.MonkeyPatch) -> CalibrationModule:
    """With one round of the search at each scale: a graph writes every round out."""
    start = module.estimator.start
    monkeypatch.setattr(start.network, "rounds", (1, 1, 1))  # type: ignore[union-attr]
    return module


def as_batch(image: Tensor, edges: Tensor, K: Tensor, T_init: Tensor) -> NetworkInput:
    rgb = (image.permute(2, 0, 1)[None].float() / 255.0 - INPUTS.rgb_mean) / INPUTS.rgb_std
    x = torch.cat([rgb, torch.zeros_like(rgb[:, :2])], 1)
    zero = torch.zeros(1, dtype=torch.int64)
    frame = FrameId("rig", "drive", 0)
    return NetworkInput(
        x, x[:, :1], K[None], T_init[None], torch.zeros(1, 6), zero, [frame], zero, edges[None]
    )


def make(
    module: CalibrationModule,
    operators: Callable[[int], Operators] = onnx_operators,
    levels: Sequence[float] = LEVELS,
) -> AlignmentGraph:
    assert module.masks is not None
    with torch.no_grad():
        return AlignmentGraph(module, INPUTS, levels, module.masks, operators).eval()


@pytest.mark.parametrize(
    ("spread", "operators"),
    [
        ("solver", onnx_operators),
        ("solver", torch_operators),
        ("dropout", onnx_operators),
        ("total", onnx_operators),
    ],
)
def test_predicts_what_the_module_predicts(
    module: CalibrationModule, spread: str, operators: Callable[[int], Operators]
) -> None:
    module.spread = spread
    arguments = example(SIZE, edges=200)
    arguments[2][[0, 1], [0, 1]] *= 2.0  # a focal length of 1.2 widths, as of the shipped weights
    with torch.no_grad():
        found = make(module, operators)(*arguments)
    wanted = module.stochastic(as_batch(*arguments), "test")
    bounds = module.estimator.bounds
    assert isinstance(bounds, Tensor)
    assert ((found.mean - wanted.mean[0]).abs() / bounds).max() < 1e-4
    for number, level in enumerate(LEVELS):
        intervals = module.calibrator.predict(wanted.mean, wanted.std, level)
        box = module.calibrator.predict_joint(wanted.mean, wanted.std, level)
        assert ((found.lower[number] - intervals.lower[0]).abs() / bounds).max() < 1e-3
        assert ((found.upper[number] - intervals.upper[0]).abs() / bounds).max() < 1e-3
        assert ((found.joint_upper[number] - box.upper[0]).abs() / bounds).max() < 1e-3
    module.spread = "solver"


def test_looks_as_far_as_the_module_looks(
    module: CalibrationModule, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = example(SIZE, edges=200)
    with torch.no_grad():
        before = make(module)(*arguments).mean
        monkeypatch.setattr(module.estimator, "reaches", (0.5, 0.1))
        found = make(module)(*arguments).mean
    wanted = module.stochastic(as_batch(*arguments), "test").mean[0]
    assert ((found - wanted).abs() / module.estimator.bounds).max() < 1e-4
    assert ((found - before).abs() / module.estimator.bounds).max() > 1e-3


def test_the_start_looks_at_the_same_surroundings(
    module: CalibrationModule, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = module.estimator.start
    assert isinstance(start, EdgeAlignmentEstimator)
    monkeypatch.setattr(start.network, "surround", (0.0, 0.0, 9.0))  # wider than the widest blur
    arguments = example(SIZE, edges=200)
    arguments[2][[0, 1], [0, 1]] *= 2.0
    with torch.no_grad():
        found = make(module)(*arguments).mean
    wanted = module.stochastic(as_batch(*arguments), "test").mean[0]
    assert ((found - wanted).abs() / module.estimator.bounds).max() < 1e-4


def test_too_few_frames_for_a_level_are_named(module: CalibrationModule) -> None:
    before = module.calibrator
    ones = torch.ones(20, 6)
    module.calibrator = ConformalCalibrator().fit(ones, ones, torch.rand(20, 6))
    with (
        pytest.warns(UserWarning, match="too few"),
        pytest.raises(ConfigurationError, match="20 calibration frames"),
    ):
        make(module, levels=[0.99])
    module.calibrator = before


def test_wrong_settings_are_named(tmp_path: Path) -> None:
    path = find_weights("unical")
    with pytest.raises(ConfigurationError, match="format=tf"):
        write_graph(path, tmp_path / "x", "tf", SIZE, LEVELS, 0)
    with pytest.raises(ConfigurationError, match="multiples of 8"):
        write_graph(path, tmp_path / "x", "onnx", (60, 161), LEVELS, 0)


def test_edges_file_needs_numpy_alone(tmp_path: Path) -> None:
    (tmp_path / "edges.py").write_text(edges_source(2048, 0.02, 0.1), encoding="utf-8")
    azimuth, elevation = np.meshgrid(np.linspace(-0.6, 0.6, 300), np.linspace(-0.2, 0.1, 16))
    distance = np.where(np.abs(azimuth) < 0.2, 6.0, 15.0)
    flat = distance * np.cos(elevation)
    xyz = flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)
    points = np.stack([*xyz, 0.3 + 0 * flat], -1).reshape(-1, 4).astype(np.float32)
    np.save(tmp_path / "points.npy", points)
    code = (
        "import sys, numpy as np, edges; K = np.array([[100., 0, 80], [0, 100, 32], [0, 0, 1]]);"
        "T = np.array([[0., -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]);"
        "np.save('found.npy', edges.edges_for_graph(np.load('points.npy'), K, T, (64, 160)));"
        "assert not {'torch', 'uncal', 'cv2'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    found = np.load(tmp_path / "found.npy")
    expected = {tuple(row) for row in find_edges(points)}
    assert found.shape[1] == len(COLUMNS)
    assert len(found) > 20
    assert {tuple(row) for row in found} <= expected


@pytest.mark.slow
def test_onnxruntime_says_what_pytorch_says(short: CalibrationModule, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from uncal.exporting.writer import to_onnx

    graph = make(short)
    to_onnx(graph, example(SIZE), tmp_path / "graph.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "graph.onnx")
    bounds = short.estimator.bounds
    assert isinstance(bounds, Tensor)
    for edges in (10, 64, 300):
        arguments = example(SIZE, edges)
        named = zip(session.get_inputs(), arguments, strict=True)
        got = session.run(None, {key.name: value.numpy() for key, value in named})
        with torch.no_grad():
            wanted = graph(*arguments)
        for one, other in zip(got, wanted, strict=True):
            assert ((torch.from_numpy(one) - other).abs() / bounds).max() < 1e-4


@pytest.mark.slow
def test_a_saved_program_loads_again_and_says_the_same(
    short: CalibrationModule, tmp_path: Path
) -> None:
    graph = make(short, torch_operators)
    to_torch(graph, example(SIZE), tmp_path / "graph.pt2")
    program = torch.export.load(tmp_path / "graph.pt2").module()
    for edges in (10, 300):
        arguments = example(SIZE, edges)
        with torch.no_grad():
            found, wanted = program(*arguments), graph(*arguments)
        for one, other in zip(found, wanted, strict=True):
            torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-5)


class Sampled(nn.Module):
    """What is hard to compile of a graph; the whole takes minutes (benchmarks/export.py)."""

    def forward(
        self, image: Tensor, edges: Tensor, K: Tensor, T_init: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Colours at the edges, and a 3×3 solve."""
        grid = edges[None, :, None, :2] / 50.0
        colours = F.grid_sample(image.permute(2, 0, 1)[None].float(), grid, align_corners=False)
        factor = torch.linalg.cholesky(K @ K.T)
        turned = T_init[:3, :3] @ edges[:, :3].T
        return colours[0, :, :, 0], torch.cholesky_solve(turned, factor).sum(-1)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="needs g++")
def test_a_compiled_program_says_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")  # where Inductor refuses to keep what it could take apart
    graph = Sampled()
    known = set(decompositions)
    to_inductor(cast(AlignmentGraph, graph), example(SIZE, 300), tmp_path / "graph.pt2")
    assert set(decompositions) == known
    compiled = torch._inductor.aoti_load_package(str(tmp_path / "graph.pt2"))
    for edges in (10, 300):
        arguments = example(SIZE, edges)
        for found, wanted in zip(compiled(*arguments), graph(*arguments), strict=True):
            torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)


def test_a_calibrator_by_drive_is_exported(module: CalibrationModule) -> None:
    before = module.calibrator
    drives = [f"drive {i % 10}" for i in range(40)]
    zeros = torch.zeros(40, 6)
    known = HierarchicalCalibrator().fit(zeros, zeros + 1.0, torch.rand(40, 6), groups=drives)
    module.calibrator = known
    graph = make(module, levels=[0.9])
    assert torch.equal(graph.quantiles[0], known.quantile(0.9))
    module.calibrator = before
