"""Simulate once: reuse what is there if it is what would be written, replace it if it is not."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

from uncal.simulation.formats.layouts import is_own_folder, layout_of
from uncal.simulation.manifest import LOCK_NAME, Manifest, read_manifest
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import PARTIAL_PREFIX, write_missing
from uncal.system.locking import locked

log = logging.getLogger(__name__)


def ensure_simulated(
    settings: SimulationSettings,
    root: Path,
    workers: int | None = None,
    progress: bool = True,
) -> Path:
    """Make ``root`` hold exactly this simulation, doing only what is missing.

    A finished simulation of the same fingerprint is reused after a look at its file counts; an
    interrupted one is resumed; one of other settings or another simulator version is replaced.

    Raises:
        RecordingError: ``root`` holds something that this simulator did not write; it is left
            untouched.
    """
    read_manifest(root)
    root.mkdir(parents=True, exist_ok=True)
    with locked(root / LOCK_NAME, f"simulates into {root}"):
        present = read_manifest(root)
        if present is not None and present.fingerprint != settings.fingerprint():
            discard(root, present, settings)
            present = None
        layout = layout_of(settings)
        missing = [rig for rig in range(settings.n_rigs) if not layout.is_complete(rig, root)]
        if present is not None and present.finished and not missing:
            log.info("reusing the simulation in %s (%d frames)", root, settings.n_frames)
            return root
        if present is not None and len(missing) < settings.n_rigs:
            log.warning(
                "%s is incomplete: %d of %d rigs are simulated again",
                root,
                len(missing),
                settings.n_rigs,
            )
        write_missing(settings, root, workers, progress)
    return root


def discard(root: Path, present: Manifest, settings: SimulationSettings) -> None:
    """Remove a simulation that is not the one wanted; the caller holds the lock of its folder.

    Args:
        root: folder of the simulation.
        present: what it holds.
        settings: what is wanted there.
    """
    log.warning(
        "%s holds a simulation with other settings or of another version (%s, wanted %s): "
        "replacing it",
        root,
        present.fingerprint,
        settings.fingerprint(),
    )
    _remove(root, present.dates)
    # Only now: a removal that is cut short must still find the old list of folders.
    Manifest.of(settings, finished=False).write(root)


def _remove(root: Path, folders: list[str]) -> None:
    """Remove a simulation's own folders, nothing else, whatever its manifest has been edited to."""
    own = [root / folder for folder in folders if is_own_folder(folder)]
    for folder in [*own, *root.glob(f"{PARTIAL_PREFIX}*")]:
        if folder.is_dir():
            shutil.rmtree(folder)
    for parent in {folder.parent for folder in own} - {root}:
        if parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()
