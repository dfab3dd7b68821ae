"""Latency of stochastic passes in units of one deterministic pass, measured side by side."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pandas as pd
import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode
from transformers.models.mobilevit.modeling_mobilevit import MobileViTLayer

from uncal.data.network_input import NetworkInput
from uncal.edges.sweep import COLUMNS, KIND, KINDS, SIDE
from uncal.recordings.frame import FrameId
from uncal.system.progress import progress_bar
from uncal.uncertainty.dropout.layers import dropout_layers
from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.mc_dropout import MCDropout

log = logging.getLogger(__name__)

DETERMINISTIC = "one deterministic pass"

ORDINALS = ("first", "second", "third", "fourth", "fifth")


def synthetic_inputs(
    size: tuple[int, ...], batch: int, edges: int, device: torch.device
) -> NetworkInput:
    """Noise, a tenth of the pixels with a LiDAR point, and edges ahead of the camera.

    Returns:
        Input of five channels and (H, W) for a batch of B frames, with (B, M, columns) edges.
    """
    generator = torch.Generator().manual_seed(0)
    height, width = size
    depth = torch.rand(batch, 1, height, width, generator=generator)
    inverse_depth = torch.where(depth < 0.1, depth, 0.0)
    image = torch.randn(batch, 3, height, width, generator=generator)
    x = torch.cat([image, inverse_depth, inverse_depth], 1)
    x = x.contiguous(memory_format=torch.channels_last)
    K = torch.tensor([[230.0, 0.0, width / 2], [0.0, 230.0, height / 2], [0.0, 0.0, 1.0]])
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    sweep = torch.rand(batch, edges, len(COLUMNS), generator=generator)
    # Within 20° to either side and 10° up or down, 5 to 40 m away.
    away = 5.0 + 35.0 * sweep[..., :1]
    aside = (2.0 * sweep[..., 1:3] - 1.0) * sweep.new_tensor([0.36, 0.18])
    sweep[..., :3] = away * torch.cat([torch.ones_like(away), aside], -1)
    sweep[..., KIND] = (len(KINDS) * sweep[..., KIND]).floor()
    sweep[..., SIDE] = sweep[..., SIDE].round() * 2 - 1
    indices = torch.arange(batch, device=device)
    return NetworkInput(
        x=x.to(device),
        inverse_depth=inverse_depth.to(device),
        K=K.repeat(batch, 1, 1).to(device),
        T_init=T.repeat(batch, 1, 1).to(device),
        target=torch.zeros(batch, 6, device=device),
        unit_index=indices,
        frames=[FrameId("made", "up", number) for number in range(batch)],
        unit=indices,
        edges=sweep.to(device),
    )


def placements(network: nn.Module) -> dict[str, list[str]]:
    """Dropout layers from each transformer stage on, and in the head only.

    Returns:
        A description → names of the layers, for ``MCDropout(select=…)``; the earliest cut first.
    """
    names = list(dropout_layers(network))
    stages = [
        name for name, module in network.named_modules() if isinstance(module, MobileViTLayer)
    ]
    if not stages:
        return {"all layers": names}
    found: dict[str, list[str]] = {}
    for number, stage in enumerate(stages):
        first = next(i for i, name in enumerate(names) if name.startswith(f"{stage}."))
        last = number == len(stages) - 1
        found[f"from the {'last' if last else ORDINALS[number]} stage on"] = names[first:]
    inside = tuple(f"{stage}." for stage in stages)
    if behind := [name for name in names if not name.startswith(inside)]:
        found["head only"] = behind
    return found


@dataclass(frozen=True)
class _Contestant:
    dropout: str
    name: str
    call: Callable[[], object]


def measure_latency(
    case: str,
    network: nn.Module,
    inputs: Sequence[Tensor],
    passes: int,
    rounds: int,
    compiled: bool,
) -> pd.DataFrame:
    """Time all strategies in turn, round by round, so that a drifting machine drifts for all.

    Args:
        case: name for the rows.
        network: (B, ...) inputs → (B, D).
        inputs: its arguments.
        passes: N.
        rounds: how often each contestant runs, after its operations are counted.
        compiled: add torch.compile (and, on a GPU, CUDA graphs).

    Returns:
        A row per contestant, the deterministic pass first: case (network and size of its input),
        batch (frames at once), dropout (where it is on), contestant (strategy and masks);
        milliseconds (median over the rounds); ratio, ratio_low and ratio_high (median, smallest
        and largest, over the rounds, of its time / that of one deterministic pass in the round);
        operations (multiplications and additions in units of one deterministic pass: the ratio on
        a machine that is never kept waiting).
    """
    network.eval()
    contestants = _contestants(network, inputs, passes, compiled)
    counts = [_operations(each.call) for each in contestants]
    times: list[list[float]] = [[] for _ in contestants]
    with progress_bar(case, rounds * len(contestants), leave=False) as bar:
        for _ in range(rounds):
            for each, measured in zip(contestants, times, strict=True):
                measured.append(1e3 * seconds(each.call, inputs[0].device))
                bar.update()
    by_round = pd.DataFrame(times).T
    ratios = by_round.div(by_round[0], axis=0)
    frame: pd.DataFrame = pd.DataFrame(
        {
            "case": case,
            "batch": len(inputs[0]),
            "dropout": [each.dropout for each in contestants],
            "contestant": [each.name for each in contestants],
            "milliseconds": by_round.median(),
            "ratio": ratios.median(),
            "ratio_low": ratios.min(),
            "ratio_high": ratios.max(),
            "operations": [count / counts[0] if counts[0] else math.nan for count in counts],
        }
    )
    return frame


def _contestants(
    network: nn.Module, inputs: Sequence[Tensor], passes: int, compiled: bool
) -> list[_Contestant]:
    def once() -> object:
        with torch.inference_mode():
            return network(*inputs)

    def asking(engine: MCDropout) -> Callable[[], object]:
        return lambda: engine(*inputs, seed=0)

    found = [_Contestant("off", DETERMINISTIC, once)]
    for number, (where, layers) in enumerate(placements(network).items()):
        if number == 0:
            for strategy in ("loop", "batch"):
                engine = MCDropout(network, passes, strategy=strategy, select=layers)
                found.append(_Contestant(where, strategy, asking(engine)))
        shared = MCDropout(network, passes, strategy="shared", select=layers)
        found.append(_Contestant(where, "shared", asking(shared)))
        masks = FixedMasks(0).to(inputs[0].device)
        fixed = MCDropout(network, passes, strategy="shared", select=layers, masks=masks)
        found.append(_Contestant(where, "shared, fixed masks", asking(fixed)))
    return found + (_compiled(network, inputs, passes) if compiled else [])


def _compiled(network: nn.Module, inputs: Sequence[Tensor], passes: int) -> list[_Contestant]:
    """What compilers make of it; one that fails is reported and left out."""
    tries: dict[str, Callable[[], Callable[[], object]]] = {
        f"{DETERMINISTIC}, torch.compile": lambda: _compile(network, inputs)
    }
    if inputs[0].is_cuda:
        tries[f"{DETERMINISTIC}, CUDA graph"] = lambda: _graphed(lambda: network(*inputs))
        layers = next(iter(placements(network).values()))
        engine = MCDropout(
            network, passes, None, strategy="shared", select=layers, masks=FixedMasks(0).cuda()
        )
        tries["shared, fixed masks, CUDA graph"] = lambda: _graphed(engine.sampler(*inputs))
    found = []
    for name, make in tries.items():
        try:
            call = make()
            call()
        except Exception as error:  # a compiler may fail in any way; the benchmark goes on
            log.warning("%s left out: %s", name, str(error).splitlines()[0])
        else:
            found.append(_Contestant("off" if DETERMINISTIC in name else "all", name, call))
    return found


def _compile(network: nn.Module, inputs: Sequence[Tensor]) -> Callable[[], object]:
    compiled = torch.compile(network)

    def call() -> object:
        with torch.inference_mode():
            return compiled(*inputs)

    return call


def _operations(call: Callable[[], object]) -> int:
    call()  # a first call tries the strategy, which must not be counted
    with FlopCounterMode(display=False) as counter:
        call()
    return int(counter.get_total_flops())


def seconds(call: Callable[[], object], device: torch.device) -> float:
    """How long a call takes, the work that it leaves to a GPU included."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    start = time.perf_counter()
    call()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start


def _graphed(function: Callable[[], object], warm_up: int = 3) -> Callable[[], object]:
    """Capture what a function does on the GPU; calling the result does it again, launch-free.

    Returns:
        Replays the graph and returns the captured output, which every replay overwrites.
    """
    with torch.inference_mode():
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(warm_up):
                function()
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            output = function()

    def replay() -> object:
        graph.replay()
        return output

    return replay
