"""The graph of trained weights as a file."""

from __future__ import annotations

import importlib.util
import logging
import os
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path

import torch
import torch._inductor
from hydra.utils import instantiate
from torch import Tensor, nn

from uncal.data.network_input import InputSettings
from uncal.edges.sweep import COLUMNS
from uncal.errors import ConfigurationError
from uncal.exporting.edges_file import edges_source
from uncal.exporting.graph import INPUTS, OUTPUTS, AlignmentGraph
from uncal.exporting.operators import onnx_operators, torch_operators
from uncal.runs.assembly import build_module
from uncal.runs.checkpoint import load_weights, read_recipe
from uncal.system.disk import check_writable
from uncal.uncertainty.dropout.masks import FixedMasks

log = logging.getLogger(__name__)

FORMATS: tuple[str, ...] = ("onnx", "torch_export", "aot_inductor")

OPSET = 18
"""Of the ONNX operators; grid_sample needs 16."""


def write_graph(
    weights: Path,
    out: Path,
    format: str,
    size: tuple[int, int],
    levels: Sequence[float] | None,
    mask_seed: int,
) -> list[Path]:
    """Write the graph.

    Args:
        weights: a checkpoint, or shipped weights.
        out: file to write.
        format: one of :data:`FORMATS`.
        size: (H, W) of the images, multiples of 8 pixels.
        levels: coverage levels; None: those of the weights.
        mask_seed: of the masks, where the weights have none of their own.

    Returns:
        The files written.

    Raises:
        ConfigurationError: an unknown format or size, a missing package, or weights that cannot be
            exported.
    """
    if format not in FORMATS:
        raise ConfigurationError(f"format={format}: expected {', '.join(FORMATS)}")
    if len(size) != 2 or any(side < 32 or side % 8 for side in size):
        raise ConfigurationError(
            f"image_size={list(size)}: expected [H, W], multiples of 8 and at least 32 pixels"
        )
    missing = [n for n in ("onnx", "onnxscript") if importlib.util.find_spec(n) is None]
    if format == "onnx" and missing:
        raise ConfigurationError(
            f"format=onnx needs {' and '.join(missing)}: pip install 'uncal[export]'"
        )
    if format == "aot_inductor":
        _refuse_inductor(out)
    check_writable(out)
    graph, inputs = make_graph(weights, format, levels, mask_seed)
    arguments = example(size)
    {"onnx": to_onnx, "torch_export": to_torch, "aot_inductor": to_inductor}[format](
        graph, arguments, out
    )
    finder = out.with_name(f"{out.stem}_edges.py")
    bounds = graph.estimator.bounds
    source = edges_source(inputs.edges, float(bounds[3]), float(bounds[0]))
    finder.write_text(source, encoding="utf-8")
    return [out, finder]


def to_onnx(graph: AlignmentGraph, arguments: tuple[Tensor, ...], out: Path) -> None:
    """Write a graph as ONNX; the number of edges may differ from call to call.

    Args:
        graph: in evaluation mode.
        arguments: of its forward, of the size that it is for.
        out: the file.
    """
    with torch.no_grad(), warnings.catch_warnings():
        # Of sizes that are constants, as they should be.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            graph,
            arguments,
            out,
            dynamo=False,
            opset_version=OPSET,
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_axes={"edges": {0: "edges"}},
        )


class _Plain(nn.Module):
    """A graph that answers with a plain tuple, since one with names cannot be saved.

    Args:
        predictor: the graph. An attribute called ``graph`` would clash with torch.fx's own.
    """

    def __init__(self, predictor: AlignmentGraph) -> None:
        super().__init__()
        self.predictor = predictor

    def forward(
        self, image: Tensor, edges: Tensor, K: Tensor, T_init: Tensor
    ) -> tuple[Tensor, ...]:
        """As :meth:`AlignmentGraph.forward`."""
        return tuple(self.predictor(image, edges, K, T_init))


def to_torch(graph: AlignmentGraph, arguments: tuple[Tensor, ...], out: Path) -> None:
    """Write a graph as a program of ``torch.export``; the number of edges may differ.

    Args:
        graph: in evaluation mode.
        arguments: of its forward, of the size that it is for.
        out: the file.
    """
    with warnings.catch_warnings():
        # Of weights that share memory, which they do not once they are saved.
        warnings.simplefilter("ignore")
        torch.export.save(_program(graph, arguments), out)


def to_inductor(graph: AlignmentGraph, arguments: tuple[Tensor, ...], out: Path) -> None:
    """Compile a graph with AOTInductor, for this machine's kind of processor; takes minutes.

    Args:
        graph: in evaluation mode.
        arguments: of its forward, of the size that it is for.
        out: the file, ``.pt2``, for ``torch._inductor.aoti_load_package`` or C++.
    """
    from torch._inductor.decomposition import decompositions
    from torch._inductor.lowering import make_fallback

    log.info("compiling %s, which takes some minutes", out)
    # Written out in elementary operations, all of the search's samplings become expressions of one
    # another, and lowering them does not end.
    whole = {op: way for op, way in decompositions.items() if "grid_sampler" in str(op)}
    for op in whole:
        del decompositions[op]
        # Said here, since Inductor, where it falls back by itself, refuses to under CI=true.
        make_fallback(op, warn=False)  # type: ignore[no-untyped-call]
    lowering = logging.getLogger("torch._inductor.ir")  # a line for every operation kept whole
    level = lowering.level
    lowering.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch._inductor.aoti_compile_and_package(
                _program(graph, arguments),
                package_path=str(out),
                # So that the table is read as it is now. Nothing in the graph is random.
                inductor_configs={"fallback_random": True},
            )
    finally:
        decompositions.update(whole)
        lowering.setLevel(level)


def _program(graph: AlignmentGraph, arguments: tuple[Tensor, ...]) -> torch.export.ExportedProgram:
    """A graph as a program; the number of edges may differ from call to call."""
    edges = torch.export.Dim("edges", min=5)
    shapes = {"image": None, "edges": {0: edges}, "K": None, "T_init": None}
    with torch.no_grad():
        return torch.export.export(
            _Plain(graph).eval(), arguments, dynamic_shapes=shapes, strict=False
        )


def _refuse_inductor(out: Path) -> None:
    compilers = [os.environ["CXX"]] if "CXX" in os.environ else ["g++", "clang++"]
    if not any(map(shutil.which, compilers)):
        raise ConfigurationError(
            f"format=aot_inductor needs a C++ compiler, and {' or '.join(compilers)} is not there: "
            "install one, or set CXX to it"
        )
    if out.suffix != ".pt2":
        raise ConfigurationError(f"out={out}: format=aot_inductor writes a file that ends in .pt2")


def make_graph(
    weights: Path, format: str, levels: Sequence[float] | None, mask_seed: int
) -> tuple[AlignmentGraph, InputSettings]:
    """The graph of trained weights, in evaluation mode.

    Args:
        weights: a checkpoint, or shipped weights.
        format: one of :data:`FORMATS`.
        levels: coverage levels; None: those of the weights.
        mask_seed: of the masks, where the weights have none of their own.

    Returns:
        Graph and what its network reads.

    Raises:
        ConfigurationError: the weights cannot be exported.
    """
    recipe = read_recipe(weights)
    if recipe.window.frames != 1:
        raise ConfigurationError(
            f"window.frames={recipe.window.frames}: a graph takes one frame; calibrate with "
            "window.frames=1"
        )
    module = build_module(recipe)
    load_weights(module, weights, calibrated=True)
    if not module.calibrator.is_fitted:
        raise ConfigurationError(f"{weights}: has no calibration; run uncal.evaluate on it first")
    if module.masks is None:
        log.warning(
            "warning: these intervals were calibrated with fresh masks (mcd.masks=random), and a "
            "graph has fixed ones: their coverage is not guaranteed. Calibrate with "
            "mcd.masks=fixed, then export, for a guarantee."
        )
    inputs: InputSettings = instantiate(recipe.model.inputs)
    masks = FixedMasks(mask_seed) if module.masks is None else module.masks
    module.eval()
    with torch.no_grad():
        chosen = list(recipe.interval.levels) if levels is None else levels
        operators = onnx_operators if format == "onnx" else torch_operators
        return AlignmentGraph(module, inputs, chosen, masks, operators).eval(), inputs


def example(size: tuple[int, int], edges: int = 64) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Inputs of the right kind, made up.

    Args:
        size: (H, W) of the image, pixels.
        edges: how many.

    Returns:
        Image, edges, K and T_init of :meth:`AlignmentGraph.forward`.
    """
    height, width = size
    draws = torch.Generator().manual_seed(0)
    found = torch.rand(edges, len(COLUMNS), generator=draws)
    found[:, :3] = found[:, :3] * torch.tensor([30.0, 12.0, 2.0]) + torch.tensor([4.0, -6.0, -1.5])
    found[:, 3] = torch.arange(edges) % 6
    found[:, 4] = 1.0
    focal = 0.6 * width
    K = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    image = torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=draws)
    return image, found, K, T
