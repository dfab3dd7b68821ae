"""Intervals from an exported graph; needs onnxruntime, NumPy and Pillow, neither torch nor uncal.

    python onnx_inference.py unical.onnx image.png sweep.bin rig.json

rig.json holds "K" (3 × 3, of the image as it is on disk) and "T_init" (4 × 4, LiDAR to camera, as
assumed). sweep.bin has float32 x, y, z, reflectance, as KITTI has. unical_edges.py, which
uncal.export wrote beside the graph, must lie beside it still.
"""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

NAMES = ("X (cm)", "Y (cm)", "Z (cm)", "Roll (°)", "Pitch (°)", "Yaw (°)")
SCALE = np.array([100.0] * 3 + [180.0 / np.pi] * 3)


def main(graph: str, image_file: str, sweep_file: str, rig_file: str) -> None:
    """Print estimate and 90% interval of each degree of freedom."""
    path = Path(graph)
    spec = importlib.util.spec_from_file_location("edges", path.with_name(f"{path.stem}_edges.py"))
    edges_file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(edges_file)

    session = onnxruntime.InferenceSession(graph)
    height, width, _ = session.get_inputs()[0].shape
    rig = json.loads(Path(rig_file).read_text())
    K, T_init = np.array(rig["K"], float), np.array(rig["T_init"], float)

    image = Image.open(image_file).convert("RGB")
    scale = max(height / image.height, width / image.width)
    w, h = max(width, round(image.width * scale)), max(height, round(image.height * scale))
    left, top = (w - width) // 2, (h - height) // 2
    sx, sy = w / image.width, h / image.height
    pixels = image.resize((w, h), Image.Resampling.BOX).crop(
        (left, top, left + width, top + height)
    )
    K[0] *= sx
    K[1] *= sy
    K[:2, 2] += (sx - 1) / 2 - left, (sy - 1) / 2 - top

    points = np.fromfile(sweep_file, np.float32).reshape(-1, 4)
    edges = edges_file.edges_for_graph(points, K, T_init, (height, width))
    inputs = np.asarray(pixels), edges, K.astype(np.float32), T_init.astype(np.float32)
    named = {entry.name: v for entry, v in zip(session.get_inputs(), inputs, strict=True)}
    mean, lower, upper, *_ = session.run(None, named)
    for name, *row in zip(NAMES, mean * SCALE, lower[0] * SCALE, upper[0] * SCALE, strict=True):
        value, low, high = row
        print(f"{name:10} {value:+8.3f}  [{low:+.3f}, {high:+.3f}]")


if __name__ == "__main__":
    main(*sys.argv[1:])
