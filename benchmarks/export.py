"""Exported graphs beside PyTorch on simulated frames: agreement and latency.

    python benchmarks/export.py OUT SIMULATED_ROOT [FRAMES]

SIMULATED_ROOT is in KITTI's raw layout. Writes OUT.md; one thread each, medians of one run.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime  # type: ignore[import-untyped]
import torch
from hydra.utils import instantiate
from torch import Tensor

from uncal.data.image_size import fit, resize_and_crop
from uncal.data.network_input import NetworkInput
from uncal.edges.selection import select_edges
from uncal.edges.sweep import find_edges
from uncal.exporting.graph import OUTPUTS, AlignmentGraph
from uncal.exporting.operators import onnx_operators, torch_operators
from uncal.exporting.writer import example, to_inductor, to_onnx, to_torch
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.models.module import CalibrationModule
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.kitti import KittiRaw
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.weights.shipped import find_weights

LEVELS = [0.9, 0.95, 0.99]
Arguments = tuple[Tensor, Tensor, Tensor, Tensor]
Answer = list[Tensor]


def main(out: Path, root: Path, frames: int = 50) -> None:
    """Compare frame by frame."""
    torch.set_num_threads(1)
    recording = KittiRaw(root)
    ids = recording.frame_ids[:: max(1, len(recording.frame_ids) // frames)][:frames]
    first = recording.load(ids[0]).image
    assert first is not None
    size = (first.shape[0] // 8 * 8, first.shape[1] // 8 * 8)
    module, graph = _models(find_weights("unical"))
    most, bounds = module.recipe["model"]["inputs"]["edges"], graph.estimator.bounds  # type: ignore[index]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "graph.onnx"
        to_onnx(graph, example(size), file)
        megabytes = file.stat().st_size / 1e6
        session = _onnx(file)
        graph.operators = torch_operators
        to_torch(graph, example(size), file.with_suffix(".pt2"))
        program = torch.export.load(file.with_suffix(".pt2")).module()
        begin = time.perf_counter()
        to_inductor(graph, example(size, most), file.with_suffix(".aot.pt2"))
        minutes = (time.perf_counter() - begin) / 60.0
        compiled = torch._inductor.aoti_load_package(str(file.with_suffix(".aot.pt2")))
    ways: dict[str, Callable[[Arguments], Answer]] = {
        "graph in PyTorch": lambda given: list(graph(*given)),
        "onnxruntime": session,
        "`torch.export`, loaded again": lambda given: list(program(*given)),
        "AOTInductor": lambda given: list(compiled(*given)),
        "uncal itself": _module(module, graph),
    }
    worst = {way: np.zeros(len(OUTPUTS)) for way in ways}
    times: dict[str, list[float]] = {way: [] for way in ways}
    finding: list[float] = []
    for number, frame_id in enumerate(ids):
        begin = time.perf_counter()
        given = _arguments(recording.load(frame_id), size, most)
        finding.append(time.perf_counter() - begin)
        answers = {}
        for way, ask in ways.items():
            begin = time.perf_counter()
            with torch.no_grad():
                answers[way] = ask(given)
            if number:  # the first warms up
                times[way].append(time.perf_counter() - begin)
        for way, found in answers.items():
            for i, (one, other) in enumerate(zip(found, answers["graph in PyTorch"], strict=True)):
                gap = float(((one - other).abs() / bounds).max())
                worst[way][i] = max(worst[way][i], gap)
    eager = float(np.median(times["graph in PyTorch"]))
    lines = [
        "# The exported graph beside PyTorch",
        "",
        f"`python benchmarks/export.py docs/results/export {root.name}`: `weights=unical`, "
        f"{size[0]}×{size[1]} px, {len(ids)} simulated frames of rigs that no training has seen, "
        f"{graph.channel_dropout.shape[0]} passes, levels {LEVELS}, the search without training "
        f"(the start) inside; ONNX file {megabytes:.1f} MB. Largest difference from the graph in "
        "PyTorch over all frames, in units of the range (10 cm, 1°); latency on one thread in "
        "units of it, medians of one run.",
        "",
        "| | " + " | ".join(f"`{name}`" for name in OUTPUTS) + " | latency |",
        "|---|" + "---|" * (len(OUTPUTS) + 1),
    ]
    for way in ways:
        gaps = " | ".join("-" if way == "graph in PyTorch" else f"{g:.1e}" for g in worst[way])
        lines.append(f"| {way} | {gaps} | {np.median(times[way]) / eager:.2f} |")
    lines += [
        "",
        f"Reading a frame and finding its edges with NumPy takes {np.median(finding) / eager:.2f} "
        "of that unit more, whichever way.",
        f"AOTInductor compiled for {minutes:.0f} minutes. torch {torch.__version__}, onnxruntime "
        f"{onnxruntime.__version__}.",
        "",
    ]
    out.with_suffix(".md").write_text("\n".join(lines), encoding="utf-8")
    sys.stdout.write("\n".join(lines))


def _models(weights: Path) -> tuple[CalibrationModule, AlignmentGraph]:
    """What `uncal.evaluate mcd.masks=fixed` runs, and the graph of it."""
    recipe = read_recipe(weights)
    recipe.mcd.masks = "fixed"
    module = build_module(recipe)
    load_weights(module, weights, calibrated=True)
    module.eval()
    assert module.masks is not None
    with torch.no_grad():
        inputs = instantiate(recipe.model.inputs)
        graph = AlignmentGraph(module, inputs, LEVELS, module.masks, onnx_operators)
    return module, graph.eval()


def _arguments(frame: Frame, size: tuple[int, int], most: int) -> Arguments:
    """Inputs of the graph, under the decalibration that evaluations draw for the frame."""
    assert frame.image is not None
    how = fit((frame.image.shape[0], frame.image.shape[1]), size)
    image, K = resize_and_crop(frame.image, frame.K, how, size)
    edges = select_edges(find_edges(frame.points), most, frame.id.index)
    span = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
    T = torch.from_numpy(frame.T_cam_lidar).float()
    T = decalibrate(T, span.draw_for(0, str(frame.id)))
    return torch.from_numpy(image), torch.from_numpy(edges), torch.from_numpy(K).float(), T


def _onnx(file: Path) -> Callable[[Arguments], Answer]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(file, options)
    names = [entry.name for entry in session.get_inputs()]

    def ask(given: Arguments) -> Answer:
        named = {name: value.numpy() for name, value in zip(names, given, strict=True)}
        return [torch.from_numpy(value) for value in session.run(None, named)]

    return ask


def _module(module: CalibrationModule, graph: AlignmentGraph) -> Callable[[Arguments], Answer]:
    """The module's own prediction and intervals."""
    calibrator, frame = module.calibrator, FrameId("rig", "drive", 0)

    def ask(given: Arguments) -> Answer:
        image, edges, K, T_init = given
        x = (image.permute(2, 0, 1)[None].float() / 255.0 - graph.mean_rgb) / graph.std_rgb
        zero = torch.zeros(1, dtype=torch.int64)
        x = torch.cat([x, torch.zeros_like(x[:, :2])], 1)
        batch = NetworkInput(
            x, x[:, :1], K[None], T_init[None], torch.zeros(1, 6), zero, [frame], zero, edges[None]
        )
        found = module.stochastic(batch, "test")
        each = [calibrator.predict(found.mean, found.std, level) for level in LEVELS]
        joint = [calibrator.predict_joint(found.mean, found.std, level) for level in LEVELS]
        return [
            found.mean[0],
            *(torch.cat([getattr(i, side) for i in each]) for side in ("lower", "upper")),
            *(torch.cat([getattr(i, side) for i in joint]) for side in ("lower", "upper")),
        ]

    return ask


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:]))
