"""Milliseconds a frame to turn a sweep into depth and intensity images, side by side in one run.

    python benchmarks/projection.py [folder of a KITTI raw recording]

Without a folder a full 64-beam sweep of a flat street is made up. Each row is the median over
rounds in which the contestants take turns, so that a machine whose speed drifts slows all alike.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.data.culling import frustum_mask
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.geometry.projection import project
from uncal.recordings.kitti import KittiRaw
from uncal.system.memory import keep_freed_memory

BATCH = 8
SIZE = (192, 640)
ROUNDS = 15
RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)


def made_up_sweep() -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64]]:
    """A full revolution of 64 beams over a road between two walls, and a KITTI-like camera."""
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-24.8, 2.0, 64)), np.radians(np.arange(-180, 180, 0.19))
    )
    flat = np.cos(elevation)
    ray = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    ray = ray.reshape(-1, 3)
    with np.errstate(divide="ignore"):
        distance = np.minimum(-1.73 / np.minimum(ray[:, 2], -1e-9), 9.0 / np.abs(ray[:, 1]))
    xyz = ray * np.minimum(distance, 80.0)[:, None]
    points = np.column_stack([xyz, np.full(len(xyz), 0.3)]).astype(np.float32)
    T = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
    return points, T, np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])


def main() -> None:
    """Time the contestants and print the table."""
    keep_freed_memory()
    if len(sys.argv) > 1:
        recording = KittiRaw(Path(sys.argv[1]))
        frames = [recording.load(frame) for frame in recording.frame_ids[:BATCH]]
        sweeps = [frame.points for frame in frames]
        T_true, K = frames[0].T_cam_lidar, frames[0].K
    else:
        sweep, T_true, K = made_up_sweep()
        sweeps = [sweep] * BATCH
    K = K * np.array([[640 / 1242], [640 / 1242], [1.0]])
    masks = [
        frustum_mask(s[:, :3], T_true, K, SIZE, RANGE.rotation, RANGE.translation) for s in sweeps
    ]
    culled = [sweep[mask] for sweep, mask in zip(sweeps, masks, strict=True)]
    T = decalibrate(
        torch.from_numpy(T_true).float().expand(len(sweeps), 4, 4), RANGE.draw(len(sweeps))
    )
    K_batch = torch.from_numpy(K).float().expand(len(sweeps), 3, 3)
    everything, near = padded(sweeps), padded(culled)
    contestants: dict[str, Callable[[], object]] = {
        "uncal, points culled by the worker": lambda: project(near, T, K_batch, SIZE),
        "uncal, all points": lambda: project(everything, T, K_batch, SIZE),
        "numpy, one frame after another, no z-buffer": lambda: [
            unbuffered(sweep, t, K) for sweep, t in zip(sweeps, T.numpy(), strict=True)
        ],
        "the worker's culling": lambda: [
            frustum_mask(s[:, :3], T_true, K, SIZE, RANGE.rotation, RANGE.translation)
            for s in sweeps
        ],
    }
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(ROUNDS):
        for name, contestant in contestants.items():
            start = time.perf_counter()
            contestant()
            times[name].append((time.perf_counter() - start) / len(sweeps) * 1e3)
    base = statistics.median(times["uncal, points culled by the worker"])
    kept = sum(map(len, culled)) / sum(map(len, sweeps))
    write = sys.stdout.write
    write(f"{len(sweeps)} frames, {len(sweeps[0])} points, {kept:.1%} kept, {SIZE}, ")
    write(f"{torch.get_num_threads()} threads\n")
    for name, values in times.items():
        median = statistics.median(values)
        write(f"{name:45s} {median:6.2f} ms/frame   ratio {median / base:5.2f}\n")


def padded(sweeps: list[NDArray[np.float32]]) -> Tensor:
    """Stack sweeps, padded with rows of NaN."""
    batch = torch.full((len(sweeps), max(map(len, sweeps)), 4), float("nan"))
    for row, sweep in zip(batch, sweeps, strict=True):
        row[: len(sweep)] = torch.from_numpy(sweep)
    return batch


def unbuffered(
    sweep: NDArray[np.float32], T: NDArray[np.float32], K: NDArray[np.float64]
) -> NDArray[np.float32]:
    """The usual way: the last point written to a pixel wins, near or far."""
    xyz = sweep[:, :3] @ T[:3, :3].T + T[:3, 3]
    ahead = xyz[:, 2] > 0.1
    xyz, reflectance = xyz[ahead], sweep[ahead, 3]
    pixels = xyz @ K.T.astype(np.float32)
    column = np.rint(pixels[:, 0] / pixels[:, 2]).astype(int)
    row = np.rint(pixels[:, 1] / pixels[:, 2]).astype(int)
    inside = (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    image = np.zeros((2, *SIZE), np.float32)
    image[0, row[inside], column[inside]] = 1.0 / xyz[inside, 2]
    image[1, row[inside], column[inside]] = reflectance[inside]
    return image


if __name__ == "__main__":
    main()
