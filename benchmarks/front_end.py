"""What finding the evidence costs, beside a dense edge correlation, side by side in one run.

    python benchmarks/front_end.py

Both look for the shift between LiDAR and image edges. The dense correlation pools the product of
two edge maps once per shift over the whole image, at two scales (81 shifts of 2 px in windows of
16 px, 49 shifts of 1 px in windows of 8 px, one output every 4 px, five pairs of edge maps); ours
reads a profile of 17 offsets along each of 1,024 edges. The network behind ours is timed too: its
convolutions, and the queries with the solver. Medians over rounds in which the contestants take
turns, so that a machine whose speed drifts slows all alike; one thread.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.edges.evidence import project_edges
from uncal.edges.image import edge_maps
from uncal.edges.sweep import COLUMNS, KIND
from uncal.geometry.decalibration import DecalibrationRange
from uncal.models.evidence import EvidenceNetwork
from uncal.models.last_round import LastRound
from uncal.system.memory import keep_freed_memory

SIZE = (80, 208)
BATCH = 8
EDGES = 1024
ROUNDS = 9
PAIRS = 5


def dense_correlation(image: Tensor, lidar: Tensor, radius: int, window: int, step: int) -> Tensor:
    """(B, PAIRS, shifts, h, w): one pooling call per shift."""
    height, width = lidar.shape[-2:]
    padded = F.pad(image, (radius,) * 4)
    side = range(2 * radius + 1)
    half = (window - step) // 2
    return torch.stack(
        [
            F.avg_pool2d(
                padded[:, :, row : row + height, column : column + width] * lidar,
                window,
                step,
                half,
                count_include_pad=False,
            )
            for row in side
            for column in side
        ],
        2,
    )


def main() -> None:
    """Time the contestants and print the table."""
    keep_freed_memory()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    bounds = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0).bounds
    network = EvidenceNetwork(3, 3, "mean", 15, [24, 48, 64], 16, [6, 8, 8], 0.25, 0.05)
    last = LastRound(network, bounds).eval()
    x = torch.randn(BATCH, 3, *SIZE)
    K = torch.tensor([[230.0, 0, 103.5], [0, 230.0, 39.5], [0, 0, 1]]).expand(BATCH, 3, 3)
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    T = T.expand(BATCH, 4, 4)
    edges = torch.rand(BATCH, EDGES, len(COLUMNS))
    scale, shift = torch.tensor([30.0, 8.0, 3.0]), torch.tensor([5.0, -4.0, -1.5])
    edges[..., :3] = edges[..., :3] * scale + shift
    edges[..., KIND] = (edges[..., KIND] * 6).floor()
    covariance = torch.eye(6).expand(BATCH, 6, 6) / 3
    halves = [torch.rand(BATCH, PAIRS, SIZE[0] // 2, SIZE[1] // 2) for _ in range(2)]
    fulls = [torch.rand(BATCH, PAIRS, *SIZE) for _ in range(2)]
    projected = project_edges(edges, K, T, SIZE, bounds)
    maps = network.describe(x)
    read = network.read(maps, projected, 2)

    def ours() -> None:
        edge_maps(x, 15)
        network.read(maps, project_edges(edges, K, T, SIZE, bounds), 2)

    def queries() -> None:
        curves, weights = network.curves(read, edges, K, projected, 2)
        last.equations(curves, weights, projected, covariance, 2)

    def dense() -> None:
        dense_correlation(halves[0], halves[1], 4, 8, 2)
        dense_correlation(fulls[0], fulls[1], 3, 8, 4)

    contestants: dict[str, Callable[[], object]] = {
        "front end: edges of the image, profiles": ours,
        "dense correlation, two scales": dense,
        "network: convolutions": lambda: network.describe(x),
        "network: queries and normal equations": queries,
    }
    times: dict[str, list[float]] = {name: [] for name in contestants}
    with torch.inference_mode():
        for _ in range(ROUNDS + 1):
            for name, run in contestants.items():
                began = time.perf_counter()
                run()
                times[name].append((time.perf_counter() - began) / BATCH * 1e3)
    medians = {name: statistics.median(values[1:]) for name, values in times.items()}
    least = medians["front end: edges of the image, profiles"]
    sys.stdout.write("| one frame of 80×208 px, one thread | ms | ratio |\n| :-- | --: | --: |\n")
    for name, value in medians.items():
        sys.stdout.write(f"| {name} | {value:.2f} | {value / least:.2f} |\n")


if __name__ == "__main__":
    main()
