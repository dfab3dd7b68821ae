"""``simulation.json``: what a simulated folder is, and the mark that it is ours to replace."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from uncal.errors import RecordingError
from uncal.simulation.formats.layouts import all_folders
from uncal.simulation.settings import VERSION, SimulationSettings

MANIFEST_NAME = "simulation.json"
LOCK_NAME = ".simulation.lock"
DRAFT_NAME = f".{MANIFEST_NAME}.new"
GENERATOR = "uncal.simulation"


@dataclass(frozen=True)
class Manifest:
    """Contents of ``simulation.json``.

    Attributes:
        generator: always :data:`GENERATOR`.
        simulated: always true; nobody should mistake the folder for a real recording.
        finished: whether every frame is there.
        fingerprint: of the settings and the simulator's version.
        version: the simulator's version.
        seed: the simulation's seed.
        n_frames: frames when finished.
        dates: the folders that belong to the simulation (KITTI: the dates), relative to the root.
        settings: all settings.
    """

    generator: str
    simulated: bool
    finished: bool
    fingerprint: str
    version: int
    seed: int
    n_frames: int
    dates: list[str]
    settings: dict[str, object]

    @classmethod
    def of(cls, settings: SimulationSettings, finished: bool) -> Manifest:
        """The manifest of a simulation with these settings."""
        return cls(
            generator=GENERATOR,
            simulated=True,
            finished=finished,
            fingerprint=settings.fingerprint(),
            version=VERSION,
            seed=settings.seed,
            n_frames=settings.n_frames,
            dates=all_folders(settings),
            settings=settings.as_dict(),
        )

    def write(self, root: Path) -> None:
        """Write into ``root``, atomically."""
        unfinished = root / DRAFT_NAME
        unfinished.write_text(json.dumps(asdict(self), indent=1) + "\n")
        unfinished.replace(root / MANIFEST_NAME)


def read_manifest(root: Path) -> Manifest | None:
    """The manifest of a simulation in ``root``; None if the folder is empty or missing.

    Raises:
        RecordingError: the folder holds something that this simulator did not write.
    """
    found = sorted(entry.name for entry in root.iterdir()) if root.is_dir() else []
    # A process that is killed before its first manifest is whole leaves these alone.
    found = [name for name in found if name not in (LOCK_NAME, DRAFT_NAME)]
    if root.exists() and not root.is_dir():
        raise RecordingError(f"{root} is a file; name a folder for the simulation")
    if not found:
        return None
    remedy = "name another folder for the simulation, or empty this one yourself"
    if MANIFEST_NAME not in found:
        shown = ", ".join(found[:5]) + (" …" if len(found) > 5 else "")
        raise RecordingError(
            f"{root} is not empty and has no {MANIFEST_NAME}, so it is left alone; it holds "
            f"{len(found)} entries ({shown}); {remedy}"
        )
    try:
        manifest = Manifest(**json.loads((root / MANIFEST_NAME).read_text()))
    except (ValueError, TypeError) as error:
        raise RecordingError(
            f"{root / MANIFEST_NAME} is not a manifest of this simulator ({error}); {remedy}"
        ) from error
    if manifest.generator != GENERATOR:
        raise RecordingError(
            f"{root / MANIFEST_NAME} was written by {manifest.generator!r}, not {GENERATOR!r}; "
            f"{remedy}"
        )
    return manifest
