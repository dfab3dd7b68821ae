"""Events per second of the event representations, beside the straightforward ways, in one run.

    python benchmarks/events.py [--events 1000000 10000000] [--workers 2]

Random events with fractional coordinates fill a window of 50 ms at 640x480: no scene has them more
scattered, so memory cannot do worse. Each row is the median over rounds in which the contestants
take turns, so that a machine whose speed drifts slows all alike. With ``--workers``, that many
processes of one thread work at the same time, as the workers of a data loader do, and the rates
are their sums.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.events.representations import Histogram, TimeSurface, VoxelGrid
from uncal.events.stream import Events, PixelMap
from uncal.system.memory import keep_freed_memory

SIZE = (480, 640)
WINDOW_US = 50_000
BINS = 15
TAU_US = 20_000.0
ROUNDS = {1_000_000: 9}
"""Rounds for so many events; three for any other number."""


def main() -> None:
    """Time the contestants and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, nargs="+", default=[1_000_000, 10_000_000])
    parser.add_argument("--workers", type=int, default=0)
    arguments = parser.parse_args()
    for n in arguments.events:
        if arguments.workers:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(arguments.workers, context) as pool:
                parts = list(pool.map(rates_of_a_worker, [n] * arguments.workers))
            rates = {name: sum(part[name] for part in parts) for name in parts[0]}
            where = f"{arguments.workers} processes of one thread"
        else:
            rates = rates_of(n)
            where = f"one process, {torch.get_num_threads()} threads"
        write = sys.stdout.write
        write(f"{n} events, {SIZE[1]}x{SIZE[0]}, {where}\n")
        for name, (reference, _) in contestants(random_events(1)).items():
            write(f"{name:55s} {rates[name] / 1e6:7.2f} M events/s")
            write(f"   {rates[name] / rates[reference]:5.1f} times {reference}\n")


def rates_of_a_worker(n: int) -> dict[str, float]:
    """As :func:`rates_of`, on one thread."""
    torch.set_num_threads(1)
    return rates_of(n)


def rates_of(n: int) -> dict[str, float]:
    """Events per second of each contestant."""
    keep_freed_memory()
    seconds: dict[str, list[float]] = {}
    turns = contestants(random_events(n))
    for _ in range(ROUNDS.get(n, 3)):
        for name, (_, contestant) in turns.items():
            start = time.perf_counter()
            contestant()
            seconds.setdefault(name, []).append(time.perf_counter() - start)
    return {name: n / statistics.median(values) for name, values in seconds.items()}


def random_events(n: int) -> Events:
    """Events anywhere in the image."""
    rng = np.random.default_rng(0)
    return Events(
        rng.uniform(0.0, SIZE[1] - 1.0, n).astype(np.float32),
        rng.uniform(0.0, SIZE[0] - 1.0, n).astype(np.float32),
        np.sort(rng.integers(0, WINDOW_US, n)),
        rng.random(n) < 0.5,
        (0, WINDOW_US),
        SIZE,
    )


def contestants(events: Events) -> dict[str, tuple[str, Callable[[], object]]]:
    """Name → the contestant to compare with, and what to time."""
    same = PixelMap.identity()
    add_at, put, maximum_at = "numpy.add.at", "put_ of eight corners", "numpy.maximum.at"
    raw, normalized = Histogram(normalize=False), Histogram(normalize=True)
    grid, standard = VoxelGrid(BINS, normalize=False), VoxelGrid(BINS, normalize=True)
    surface = TimeSurface(TAU_US)
    return {
        "uncal, histogram": (add_at, lambda: raw(events, SIZE, same)),
        "uncal, histogram, normalised": (add_at, lambda: normalized(events, SIZE, same)),
        add_at: (add_at, lambda: usual_histogram(events)),
        f"uncal, voxel grid, {BINS} bins": (put, lambda: grid(events, SIZE, same)),
        f"uncal, voxel grid, {BINS} bins, normalised": (
            f"{put}, normalised",
            lambda: standard(events, SIZE, same),
        ),
        put: (put, lambda: usual_voxel_grid(events)),
        f"{put}, normalised": (f"{put}, normalised", lambda: usual_normalized_grid(events)),
        "uncal, time surface": (maximum_at, lambda: surface(events, SIZE, same)),
        maximum_at: (maximum_at, lambda: usual_time_surface(events)),
    }


def usual_pixels(
    events: Events,
) -> tuple[NDArray[np.bool_], tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Which events are inside, and the polarity, row and column of those."""
    column, row = np.rint(events.x).astype(np.int64), np.rint(events.y).astype(np.int64)
    inside = (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    return inside, (events.p[inside].astype(np.int64), row[inside], column[inside])


def usual_histogram(events: Events) -> Tensor:
    """Counts, one after another."""
    _, cells = usual_pixels(events)
    image = np.zeros((2, *SIZE), np.float32)
    np.add.at(image, cells, np.float32(1.0))
    return torch.from_numpy(image)


def usual_time_surface(events: Events) -> Tensor:
    """The latest times, one after another."""
    inside, cells = usual_pixels(events)
    latest = np.full((2, *SIZE), -np.inf, np.float32)
    np.maximum.at(latest, cells, (events.t[inside] - WINDOW_US).astype(np.float32))
    return torch.from_numpy(np.exp(latest / np.float32(TAU_US)))


def usual_voxel_grid(events: Events) -> Tensor:
    """One corner after another, each with its mask, as loaders of event data commonly do."""
    x, y = torch.from_numpy(events.x), torch.from_numpy(events.y)
    b = torch.from_numpy(events.t).float() * ((BINS - 1) / WINDOW_US)
    sign = 2.0 * torch.from_numpy(events.p).float() - 1.0
    x0, y0, b0 = x.floor().long(), y.floor().long(), b.floor().long()
    grid = torch.zeros(BINS, *SIZE)
    for column in (x0, x0 + 1):
        for row in (y0, y0 + 1):
            for plane in (b0, b0 + 1):
                inside = (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
                inside &= (plane >= 0) & (plane < BINS)
                weight = (1 - (column - x).abs()) * (1 - (row - y).abs()) * (1 - (plane - b).abs())
                cells = (plane * SIZE[0] + row) * SIZE[1] + column
                grid.put_(cells[inside], (sign * weight)[inside], accumulate=True)
    return grid


def usual_normalized_grid(events: Events) -> Tensor:
    """The same with the cells that are not zero picked out and standardised."""
    grid = usual_voxel_grid(events)
    occupied = torch.nonzero(grid, as_tuple=True)
    grid[occupied] = (grid[occupied] - grid[occupied].mean()) / grid[occupied].std()
    return grid


if __name__ == "__main__":
    main()
