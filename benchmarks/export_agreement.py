"""An exported graph beside PyTorch on 50 simulated frames: agreement and latency.

python benchmarks/export_agreement.py unical.onnx SIMULATED_ROOT
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime  # type: ignore[import-untyped]
import torch

from uncal.data.image_size import fit, resize_and_crop
from uncal.edges.selection import select_edges
from uncal.edges.sweep import find_edges
from uncal.exporting.writer import make_graph
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.recordings.kitti import KittiRaw
from uncal.weights.shipped import find_weights


def main(file: str, root: str, frames: int = 50) -> None:
    """Print the largest differences, in units of the range, and the ratio of latencies."""
    torch.set_num_threads(1)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(file, options)
    names = [entry.name for entry in session.get_inputs()]
    size = (session.get_inputs()[0].shape[0], session.get_inputs()[0].shape[1])
    graph, inputs = make_graph(find_weights("unical"), [0.9, 0.95, 0.99], 0)
    bounds = graph.estimator.bounds
    span = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
    recording = KittiRaw(Path(root))
    worst, times = np.zeros(5), np.zeros((2, frames))
    ids = list(recording.frame_ids)[:frames]
    for number, frame_id in enumerate(ids):
        frame = recording.load(frame_id)
        assert frame.image is not None
        how = fit((frame.image.shape[0], frame.image.shape[1]), size)
        image, K = resize_and_crop(frame.image, frame.K, how, size)
        edges = select_edges(find_edges(frame.points), inputs.edges, frame_id.index)
        T = torch.from_numpy(frame.T_cam_lidar).float()
        T = decalibrate(T, span.draw_for(0, str(frame_id)))
        given = (torch.from_numpy(image), torch.from_numpy(edges), torch.from_numpy(K).float(), T)
        start = time.perf_counter()
        with torch.no_grad():
            wanted = graph(*given)
        between = time.perf_counter()
        got = session.run(None, {n: v.numpy() for n, v in zip(names, given, strict=True)})
        times[:, number] = between - start, time.perf_counter() - between
        for i, (one, other) in enumerate(zip(got, wanted, strict=True)):
            difference = ((torch.from_numpy(one) - other).abs() / bounds).max()
            worst[i] = max(worst[i], float(difference))
    print(f"{len(ids)} frames; largest difference / range, per output: {worst}")
    eager, exported = np.median(times[:, : len(ids)], axis=1)
    print(f"latency, onnxruntime / eager: {exported / eager:.2f}")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
