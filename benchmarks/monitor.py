"""Frames per second of the monitor's whole loop, the share of each stage, and its memory.

    python benchmarks/monitor.py                        # 80×208 and 160×416, shipped weights
    python benchmarks/monitor.py --frames 10000 --size 80 208 --memory

Frames are made up once (boxes before a wall, an image of noise smoothed), and then come over and
over with new points and pixels, so that no sensor looks frozen. They are not read from a disk.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch

from uncal.monitor import Monitor
from uncal.monitor.loop import Loop
from uncal.monitor.run_folder import RunFolder
from uncal.recordings.frame import Frame, FrameId
from uncal.system.memory import keep_freed_memory

T = np.array([[0.0, -1, 0, 0.05], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
FOCAL_PX = 460.0
"""Of the shipped weights: images are used as they are."""


def made_up(size: tuple[int, int], beams: int) -> Frame:
    """One frame of a camera of this size and a LiDAR that sees a quarter of the horizon."""
    rng = np.random.default_rng(0)
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(2, -24, beams)), np.radians(np.arange(45, -45, -0.18)), indexing="ij"
    )
    depth = np.where((np.degrees(azimuth) // 3 + np.degrees(elevation) // 4) % 2 == 0, 8.0, 14.0)
    flat = depth * np.cos(elevation)
    x, y, z = flat * np.cos(azimuth), flat * np.sin(azimuth), depth * np.sin(elevation)
    points = np.stack([x, y, z, rng.uniform(0, 1, depth.shape)], -1).reshape(-1, 4)
    image = cv2.GaussianBlur(rng.integers(0, 256, (*size, 3), dtype=np.uint8), (0, 0), 2.0)
    image = cv2.normalize(image, np.empty_like(image), 0, 255, cv2.NORM_MINMAX)
    K = np.array([[FOCAL_PX, 0, size[1] / 2 - 0.5], [0, FOCAL_PX, size[0] / 2 - 0.5], [0, 0, 1.0]])
    image = np.asarray(image, np.uint8)
    pixels = np.asarray(image, np.uint8)
    return Frame(FrameId("rig", "drive", 0), pixels, points.astype(np.float32), K, T, 0.0)


def stream(frame: Frame, count: int, memory: list[tuple[int, float]]) -> Iterator[Frame]:
    """The frame over and over, a little different each time; resident memory now and then."""
    rng = np.random.default_rng(1)
    assert frame.image is not None
    for number in range(count):
        if number % max(1, count // 20) == 0:
            memory.append((number, resident_mib()))
        points = frame.points.copy()
        points[:, :3] *= rng.normal(1.0, 0.001, (len(points), 1)).astype(np.float32)
        image = np.roll(frame.image, number % 7, axis=1)
        frame_id = replace(frame.id, index=number)
        yield replace(frame, id=frame_id, image=image, points=points, time=0.1 * number)
    memory.append((count, resident_mib()))


def resident_mib() -> float:
    """Memory of this process in use."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return float("nan")


def measure(size: tuple[int, int], args: argparse.Namespace) -> None:
    """One size: a warm-up, then the loop with its files."""
    memory: list[tuple[int, float]] = []
    monitor = Monitor(args.weights, device=args.device)
    frame = made_up(size, args.beams)
    with tempfile.TemporaryDirectory() as folder:
        for _, warm in zip(range(3), stream(frame, 3, []), strict=False):
            monitor.reader.evidence(warm, warm.T_cam_lidar, monitor.settings.sensors)
        assert monitor.reader.sample is not None
        edges = len(monitor.reader.sample.edges)
        with RunFolder(Path(folder), monitor, {}) as run:
            loop = Loop(monitor, run, [], None)
            begin = time.process_time()
            loop.over(stream(frame, args.frames, memory))
            cpu = time.process_time() - begin
    print(
        f"{size[0]}×{size[1]}, {monitor.reader.module.engine.passes} passes, {edges} edges, "
        f"{torch.get_num_threads()} threads, {monitor.reader.device}: {loop.shares()}; "
        f"{1e3 * cpu / args.frames:.0f} ms of processor time a frame"
    )
    if args.memory:
        print("frames, MiB:", ", ".join(f"{n}: {mib:.0f}" for n, mib in memory))


def main() -> None:
    """Measure all sizes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", default="unical")
    parser.add_argument("--size", type=int, nargs=2, default=None, metavar=("H", "W"))
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--beams", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--memory", action="store_true", help="print resident memory over time")
    args = parser.parse_args()
    keep_freed_memory()
    torch.set_num_threads(args.threads)
    for size in [tuple(args.size)] if args.size else [(80, 208), (160, 416)]:
        measure((size[0], size[1]), args)


if __name__ == "__main__":
    main()
