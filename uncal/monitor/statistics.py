"""What frames look like, in numbers that are compared with those of the references."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.data.dataset import Sample
from uncal.monitor.settings import SensorLimits
from uncal.recordings.frame import Frame

Vector = NDArray[np.float64]

STATISTICS: tuple[str, ...] = (
    *("brightness", "contrast", "sharpness"),
    *("number of points", "range", "reflectance", "number of edges"),
    *("fit of the edges", "solver's residual", "σ of the frame alone"),
)
"""Of a frame, in the order of :func:`frame_statistics`."""

WINDOWED: tuple[str, ...] = (*STATISTICS, "σ", "disagreement of the frames")
"""Of a window: means of its frames' statistics, and what only the window has."""


def frame_statistics(sample: Sample, fits: float, residual: float, log_sigma: float) -> Vector:
    """What one frame looks like.

    Args:
        sample: at the network's size, culled.
        fits: how well its edges lie on those of the image, :func:`uncal.monitor.pairing.fit`.
        residual: of the solver, pixels.
        log_sigma: mean logarithm of σ of the frame alone.

    Returns:
        (K,) as :data:`STATISTICS`: mean, standard deviation and gradient (relative to it) of the
        camera; log number of points near the image, their log median range and mean reflectance;
        log number of edges; fit; residual; log σ.
    """
    camera = sample.camera.float().mean(0)
    contrast = float(camera.std())
    steps = torch.cat([camera.diff(dim=0).flatten(), camera.diff(dim=1).flatten()])
    points = sample.points.numpy()
    ranges = np.linalg.norm(points[:, :3], axis=1) if len(points) else np.ones(1)
    return np.array(
        [
            float(camera.mean()),
            contrast,
            float(steps.abs().mean()) / max(contrast, 1e-6),
            np.log1p(len(points)),
            np.log(max(float(np.median(ranges)), 1e-3)),
            float(points[:, 3].mean()) if len(points) else 0.0,
            np.log1p(len(sample.edges)),
            fits,
            residual,
            log_sigma,
        ]
    )


class SensorCheck:
    """Says when a sensor gives nothing to go by: missing, frozen, dark, empty.

    Args:
        limits: what is too little.

    Attributes:
        last: digests of what camera and LiDAR gave before.
    """

    def __init__(self, limits: SensorLimits) -> None:
        self.limits = limits
        self.last = ("", "")

    def fault(self, frame: Frame) -> str | None:
        """What is wrong with a frame; None if nothing is.

        Args:
            frame: the next one of the stream.
        """
        limits, problems = self.limits, []
        if frame.image is not None:
            small = frame.image[::4, ::4]
            camera = _digest(small)
            if (mean := float(small.mean())) < limits.min_brightness:
                problems.append(
                    f"the camera is dark: mean {mean:.1f} of 255, below {limits.min_brightness:g}"
                )
            elif (std := float(small.std())) < limits.min_contrast:
                problems.append(
                    f"the image shows nothing: standard deviation {std:.1f} of 255, below "
                    f"{limits.min_contrast:g}"
                )
        elif frame.events is not None:
            camera = _digest(frame.events.t)
            if len(frame.events.t) < limits.min_events:
                problems.append(f"{len(frame.events.t)} events, fewer than {limits.min_events}")
        else:
            camera = ""
            problems.append("no camera: neither an image nor events")
        lidar = _digest(frame.points[::4])
        if len(frame.points) < limits.min_points:
            problems.append(f"{len(frame.points)} LiDAR points, fewer than {limits.min_points}")
        elif lidar == self.last[1]:
            problems.append("the LiDAR is frozen: the same sweep as before")
        if camera and camera == self.last[0]:
            problems.append("the camera is frozen: the same image as before")
        self.last = camera, lidar
        return "; ".join(problems) or None


def _digest(values: NDArray[np.generic]) -> str:
    return hashlib.blake2b(np.ascontiguousarray(values).tobytes(), digest_size=16).hexdigest()
