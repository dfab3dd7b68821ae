"""What the monitor is calibrated on: windows of drives whose extrinsic is trusted.

Every stretch of ``window`` consecutive frames is decalibrated at random, and the windowed estimator
itself is run on it, exactly as on a stream: after its 1st, 2nd … last frame stand the error, σ, and
what the frames look like. Intervals come from those errors, never from σ/√n.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.statistics import STATISTICS, WINDOWED
from uncal.reporting.layout import replaced_whole
from uncal.uncertainty.conformal.groups import HierarchicalCalibrator
from uncal.uncertainty.conformal.quantile import miscoverage, samples_needed
from uncal.uncertainty.conformal.split_conformal import ConformalCalibrator
from uncal.weights.digest import digest_of
from uncal.weights.shipped import load_shipped

Vector = NDArray[np.float64]

SIMULATED = "simulated: "
"""How the label of references begins that no real sensor recorded."""

INSIDE = "monitor.references"
"""Name of the tensor of references in a file of weights."""

_SEARCHED_WITH = ("rounds", "reaches", "start", "search")
"""Settings of a model that no weights hold, and that decide what it finds all the same."""

FLOOR = 1e-6
"""Smallest σ to divide by, metres and radians."""


@dataclass(frozen=True)
class References:
    """Windows of drives whose extrinsic is trusted.

    Attributes:
        made_with: fingerprint of the estimator: weights, passes, window and so on.
        label: which recordings.
        drives: (m,) drive of each window.
        error: (m, W, 6) estimate - truth after 1 … W frames, metres and radians.
        std: (m, W, 6) σ.
        frames: (m, W, K) :data:`uncal.monitor.statistics.STATISTICS` of the frames.
        windows: (m, K') :data:`uncal.monitor.statistics.WINDOWED` of the full windows.
        jumps: (m,) largest :meth:`~uncal.monitor.window.Window.jump` within each window.
    """

    made_with: dict[str, object]
    label: str
    drives: list[str]
    error: Vector
    std: Vector
    frames: Vector
    windows: Vector
    jumps: Vector

    @property
    def jump(self) -> float:
        """Largest contradiction of frames whose extrinsic did not change; 0: none was looked at."""
        return float(self.jumps.max())

    def count(self, exchangeable: str) -> int:
        """How many drives, or windows."""
        return len(set(self.drives)) if exchangeable == "drive" else len(self.drives)

    def highest_level(self, exchangeable: str) -> float:
        """Highest level that intervals can have, rounded down.

        Args:
            exchangeable: as in :meth:`calibrators`.
        """
        n = self.count(exchangeable)
        return math.floor(1e4 * n / (n + 1)) / 1e4

    def calibrators(self, exchangeable: str) -> list[ConformalCalibrator]:
        """Those of 1 … W frames.

        Args:
            exchangeable: ``drive``: intervals hold for a new drive; ``window``: for other windows
                of drives like these, which takes fewer drives and promises less.
        """
        made: list[ConformalCalibrator] = []
        for n in range(self.error.shape[1]):
            kind = HierarchicalCalibrator if exchangeable == "drive" else ConformalCalibrator
            mean, std = torch.from_numpy(self.error[:, n]), torch.from_numpy(self.std[:, n])
            target = torch.zeros_like(mean)
            calibrator = kind(DOF_NAMES, FLOOR)
            made.append(calibrator.fit(mean, std, target, groups=self.drives))
        return made

    def check_level(self, level: float, exchangeable: str) -> None:
        """Refuse a level that so few drives or windows say nothing about.

        Args:
            level: of the intervals.
            exchangeable: as in :meth:`calibrators`.

        Raises:
            ConfigurationError: names how many are needed.
        """
        n = self.count(exchangeable)
        needed = samples_needed(miscoverage(level))
        if n < needed:
            hint = (
                ", or set exchangeable=window, which promises coverage on drives like these only"
                if exchangeable == "drive" and len(self.drives) >= needed
                else ""
            )
            raise ConfigurationError(
                f"level={level:g}: the references hold {n} {exchangeable}(s), and intervals of "
                f"that level need {needed}: calibrate with more{hint}"
            )

    @cached_property
    def _ranges(self) -> tuple[Vector, Vector]:
        seen = self.frames.reshape(-1, self.frames.shape[-1])
        return seen.min(0), seen.max(0)

    def unlike(self, statistics: Vector, margin: float) -> str | None:
        """What of a frame lies far outside all that the references show; None if nothing does.

        Args:
            statistics: (K,) of the frame.
            margin: how far outside is far, in widths of the references' range.
        """
        low, high = self._ranges
        slack = margin * (high - low) + 1e-9
        for name, value, a, b, far in zip(STATISTICS, statistics, low, high, slack, strict=True):
            if not a - far <= value <= b + far:
                return f"{name} is {value:.2f}, far from the references' {a:.2f} to {b:.2f}"
        return None

    def save(self, path: Path) -> Path:
        """Write them as one file without pickles.

        Args:
            path: ending in .npz.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced_whole(path) as partial:
            partial.write_bytes(self._bytes())
        return path

    def packed(self) -> torch.Tensor:
        """The same file as a tensor of bytes, for a file of weights; see :data:`INSIDE`."""
        return torch.frombuffer(bytearray(self._bytes()), dtype=torch.uint8)

    def _bytes(self) -> bytes:
        about = json.dumps({"made_with": self.made_with, "label": self.label})
        file = io.BytesIO()
        np.savez_compressed(
            file,
            about=np.array(about),
            drives=np.array(self.drives),
            error=self.error,
            std=self.std,
            frames=self.frames,
            windows=self.windows,
            jumps=self.jumps,
        )
        return file.getvalue()

    @classmethod
    def load(cls, path: Path, made_with: dict[str, object]) -> References:
        """Read them.

        Args:
            path: of :meth:`save`, or a file of weights that holds them.
            made_with: fingerprint of the estimator that they are for.

        Raises:
            ConfigurationError: no such file, a damaged one, or one of another estimator.
        """
        try:
            source = io.BytesIO(_inside(path)) if path.suffix == ".safetensors" else path
            with np.load(source, allow_pickle=False) as file:
                about = json.loads(str(file["about"]))
                found = cls(
                    about["made_with"],
                    about["label"],
                    [str(name) for name in file["drives"]],
                    *(file[name] for name in ("error", "std", "frames", "windows", "jumps")),
                )
        except FileNotFoundError as error:
            raise ConfigurationError(
                f"references={path}: no such file; make it from recordings with trusted "
                "extrinsics: "
                f"python -m uncal.monitor calibrate=FOLDER references={path}"
            ) from error
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise ConfigurationError(
                f"references={path}: not references that uncal.monitor wrote ({error}); make them "
                "anew with calibrate=FOLDER"
            ) from error
        other = [
            f"{key}: {found.made_with.get(key)}, here {value}"
            for key, value in made_with.items()
            if found.made_with.get(key) != value
        ]
        if other:
            raise ConfigurationError(
                f"references={path}: made with another estimator ({'; '.join(other)}); give the "
                "same settings, or make them anew with calibrate=FOLDER"
            )
        return found


def find_references(weights: Path, made_with: dict[str, object]) -> References | None:
    """Those beside a file of weights, or within it, as ``uncal.calibrate`` writes them.

    Args:
        weights: their file.
        made_with: fingerprint of the estimator that they are for.

    Returns:
        None if there are none.

    Raises:
        ConfigurationError: they are damaged, or of another estimator.
    """
    beside = references_beside(weights)
    if beside.is_file():
        return References.load(beside, made_with)
    if weights.suffix == ".safetensors" and INSIDE in load_shipped(weights)[0]:
        return References.load(weights, made_with)
    return None


def _inside(weights: Path) -> bytes:
    return load_shipped(weights)[0][INSIDE].numpy().tobytes()


def references_beside(weights: Path) -> Path:
    """Where the references of weights are looked for.

    Args:
        weights: their file.

    >>> references_beside(Path("weights/unical.safetensors")).as_posix()
    'weights/unical.monitor.npz'
    """
    return weights.with_suffix(".monitor.npz")


def fingerprint(reader: EvidenceReader, settings: MonitorSettings) -> dict[str, object]:
    """What references belong to.

    Args:
        reader: the weights.
        settings: of the monitor.
    """
    identity = reader.module.engine.identity()
    model = cast("dict[str, object]", reader.module.recipe.get("model", {}))
    return {
        "weights": identity.weights[:16],
        "passes": identity.passes,
        "rates": [float(rate) for rate in identity.rates],
        "masks": identity.masks[:16],
        "spread": reader.module.spread,
        "edges": reader.inputs.edges,
        "range": [float(f"{bound:.6g}") for bound in reader.bounds],
        "window": settings.window,
        "forgetting": settings.forgetting,
        "start": reader.ask.start_inflation if reader.counts_start else 0.0,
        "statistics": list(WINDOWED),
        "estimator": digest_of({key: model.get(key) for key in _SEARCHED_WITH}),
    }
