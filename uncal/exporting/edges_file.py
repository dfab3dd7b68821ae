"""A Python file that finds the edges of a sweep with NumPy alone, put together from this package's.

Sorting a sweep by laser and azimuth is not part of the graph, which begins with edges.
"""

from __future__ import annotations

import inspect
from types import ModuleType

from uncal.data import culling
from uncal.edges import rings, selection, sweep

_MODULES: tuple[ModuleType, ...] = (rings, sweep, selection, culling)

_ENTRY = '''

def edges_for_graph(points, K, T_init, image_size, most={most}, seed=0):
    """Edges of one sweep that the image can show, for the graph's input of that name.

    Args:
        points: (N, 4) float32 x, y, z in metres in the LiDAR frame and reflectance in 0..1, of one
            sweep in the order of its file.
        K: (3, 3) camera matrix of the image that the graph is given, pixels.
        T_init: (4, 4) assumed extrinsic, LiDAR to camera.
        image_size: (H, W) of that image, pixels.
        most: keep at most so many.
        seed: of their order.

    Returns:
        (M, 9) float32.
    """
    found = find_edges(np.asarray(points, np.float32))
    T, K = np.asarray(T_init, np.float64), np.asarray(K, np.float64)
    near = frustum_mask(found[:, :3], T, K, image_size, {rotation!r}, {translation!r})
    return select_edges(found[near], most, seed)
'''


def edges_source(most: int, rotation: float, translation: float) -> str:
    """The file's text.

    Args:
        most: edges that the network was calibrated with.
        rotation: largest rotation that T_init may be off by, radians.
        translation: largest translation, metres.
    """
    parts = [
        '"""Edges of a LiDAR sweep; needs NumPy only. Written by uncal.export (Apache-2.0)."""\n',
        "from __future__ import annotations\n",
        "import math\n",
        "import numpy as np\nfrom numpy.typing import NDArray\n",
    ]
    for module in _MODULES:
        lines = inspect.getsource(module).splitlines()
        first = next(i for i, line in enumerate(lines) if line.startswith("from __future__"))
        kept = [x for x in lines[first + 1 :] if not x.startswith(("import ", "from "))]
        parts.append("\n".join(kept).strip() + "\n\n")
    return "\n".join(parts) + _ENTRY.format(most=most, rotation=rotation, translation=translation)
