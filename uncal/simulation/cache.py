"""Simulate once: reuse what is there if it is what would be written, replace it if it is not."""

from __future__ import annotations

from pathlib import Path

from uncal.errors import ConfigurationError
from uncal.simulation.manifest import missing_rigs
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import available_cores, write_rigs
from uncal.system.locking import note_reading


def ensure_simulated(
    settings: SimulationSettings, root: Path, workers: int | None = None, progress: bool = True
) -> Path:
    """Make ``root`` hold exactly this simulation, doing only what is missing; gives ``root``.

    A finished simulation of the same fingerprint is reused after a look at its file counts; an
    interrupted one is resumed; one of other settings or another simulator version is replaced. The
    result does not depend on the number of ``workers`` (None: one per available core).

    Raises:
        RecordingError: ``root`` holds something that this simulator did not write, or another
            simulation that another process reads; it is left untouched. Or a worker died.
        ConfigurationError: ``workers`` is not positive.
    """
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise ConfigurationError(f"workers is {workers!r}; it must be at least 1, or null for all")
    with missing_rigs(settings, root) as missing:
        if missing:
            write_rigs(settings, root, missing, workers or available_cores(), progress)
        note_reading(root)
    return root
