"""``simulation.json``: what a simulated folder is, and the mark that it is ours to replace.

A layout prepares a rig, its pieces are written by any number of processes, and it is finished, all
in a folder ``partial`` that mirrors the root; then its folders move to the root.
"""

from __future__ import annotations

import json
import logging
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from uncal.errors import RecordingError
from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.settings import VERSION, SimulationSettings
from uncal.system.locking import locked, other_readers

if TYPE_CHECKING:
    from uncal.simulation.formats.dsec_folder import DsecLayout

log = logging.getLogger(__name__)

MANIFEST_NAME = "simulation.json"
LOCK_NAME = ".simulation.lock"
DRAFT_NAME = f".{MANIFEST_NAME}.new"
GENERATOR = "uncal.simulation"

Layout: TypeAlias = "KittiLayout | DsecLayout"

PARTIAL_PREFIX = ".partial_"

_FOLDER = re.compile(r"\d{4}_\d{2}_\d{2}|sim_\d{4}_[a-z]|data/sim_\d{4}")


def layout_of(settings: SimulationSettings) -> Layout:
    """DSEC's layout for an event camera, KITTI's for an ordinary one."""
    if settings.events is None:
        return KittiLayout(settings)
    # Only here: HDF5 and ROS take a second to load, in every process.
    from uncal.simulation.formats.dsec_folder import DsecLayout

    return DsecLayout(settings)


def is_own_folder(folder: str) -> bool:
    """Whether a simulation may write, and so replace, a folder of this name.

    >>> [is_own_folder(name) for name in ("2041_01_02", "data/sim_0007", "../thesis", "data")]
    [True, True, False, False]
    """
    return _FOLDER.fullmatch(folder) is not None


@dataclass(frozen=True)
class Manifest:
    """Contents of ``simulation.json``."""

    generator: str  # always GENERATOR
    simulated: bool  # always true; nobody should mistake the folder for a real recording
    finished: bool  # whether every frame is there
    fingerprint: str  # of the settings and the simulator's version
    version: int  # the simulator's
    seed: int
    n_frames: int  # when finished
    dates: list[str]  # its folders (KITTI: the dates), relative to the root
    settings: dict[str, object]

    @classmethod
    def of(cls, settings: SimulationSettings, finished: bool) -> Manifest:
        """The manifest of a simulation with these settings."""
        layout = layout_of(settings)
        return cls(
            generator=GENERATOR,
            simulated=True,
            finished=finished,
            fingerprint=settings.fingerprint(),
            version=VERSION,
            seed=settings.seed,
            n_frames=settings.n_frames,
            dates=[folder for rig in range(settings.n_rigs) for folder in layout.folders(rig)],
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
    if root.exists() and not root.is_dir():
        raise RecordingError(f"{root} is a file; name a folder for the simulation")
    found = sorted(entry.name for entry in root.iterdir()) if root.is_dir() else []
    # A process that is killed before its first manifest is whole leaves these alone.
    found = [name for name in found if name not in (LOCK_NAME, DRAFT_NAME)]
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


@contextmanager
def missing_rigs(settings: SimulationSettings, root: Path) -> Iterator[list[int]]:
    """Hold a folder while the caller simulates what is missing in it, which makes it finished.

    A simulation of other settings or of another version of the simulator is removed first, unless
    another process reads it.

    Yields:
        Numbers of the rigs that are not there as a whole.

    Raises:
        RecordingError: ``root`` holds something that this simulator did not write, or another
            simulation that is being read; it is left untouched.
    """
    read_manifest(root)
    root.mkdir(parents=True, exist_ok=True)
    with locked(root / LOCK_NAME, f"simulates into {root}"):
        present = read_manifest(root)
        if present is not None and present.fingerprint != settings.fingerprint():
            readers = other_readers(root)
            if readers:
                raise RecordingError(
                    f"{root} holds a simulation with other settings, which process "
                    f"{', '.join(readers)} reads now, so it is not replaced; wait for its end, or "
                    "give this simulation another folder (dataset.root=… or root=…)"
                )
            log.warning(
                "%s holds a simulation with other settings or of another version (%s, wanted %s): "
                "replacing it",
                *(root, present.fingerprint, settings.fingerprint()),
            )
            _remove(root, present.dates)
            present = None
        layout, n = layout_of(settings), settings.n_rigs
        missing = [rig for rig in range(n) if not layout.is_complete(rig, root)]
        if present is not None and present.finished and not missing:
            log.info("reusing the simulation in %s (%d frames)", root, settings.n_frames)
            yield []
            return
        if present is not None and len(missing) < n:
            sentence = "%s is incomplete: %d of %d rigs are simulated again"
            log.warning(sentence, root, len(missing), n)
        # Only now: a removal that is cut short must still find the old list of folders.
        Manifest.of(settings, finished=False).write(root)
        for leftover in root.glob(f"{PARTIAL_PREFIX}*"):
            shutil.rmtree(leftover)
        yield missing
        Manifest.of(settings, finished=True).write(root)


def _remove(root: Path, folders: list[str]) -> None:
    """Remove a simulation's own folders, nothing else, whatever its manifest has been edited to."""
    own = [root / folder for folder in folders if is_own_folder(folder)]
    for folder in own:
        if folder.is_dir():
            shutil.rmtree(folder)
    for parent in {folder.parent for folder in own} - {root}:
        if parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()
