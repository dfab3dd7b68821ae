"""What the layouts have in common: which folders belong to a rig and how they come about."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Protocol

from uncal.simulation.formats.drive import Piece
from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.settings import SimulationSettings

_FOLDER = re.compile(r"\d{4}_\d{2}_\d{2}|sim_\d{4}_[a-z]|data/sim_\d{4}")


class Layout(Protocol):
    """Writes the rigs of a simulation as one kind of recording.

    A rig is prepared, its pieces are written by any number of processes, and it is finished, all
    in a folder ``partial`` that mirrors the root; then its folders move to the root.
    """

    def folders(self, rig: int) -> list[str]:
        """Every folder of a rig, relative to the root, in the order in which they move there."""
        ...

    def prepare(self, rig: int, partial: Path) -> None:
        """Create what does not depend on the frames; ``partial`` must not exist yet."""
        ...

    def write(self, piece: Piece, partial: Path) -> int:
        """Simulate the frames of a piece; returns the bytes written.

        Raises:
            RecordingError: a file could not be written.
        """
        ...

    def finish(self, rig: int, partial: Path) -> None:
        """Put together what the pieces left, once all are written."""
        ...

    def is_complete(self, rig: int, root: Path) -> bool:
        """Whether a rig is there as a whole, as far as a look at the files' names tells."""
        ...


def layout_of(settings: SimulationSettings) -> Layout:
    """DSEC's layout for an event camera, KITTI's for an ordinary one."""
    if settings.events is None:
        return KittiLayout(settings)
    # Only here: HDF5 and ROS take a second to load, in every process.
    from uncal.simulation.formats.dsec_folder import DsecLayout

    return DsecLayout(settings)


def all_folders(settings: SimulationSettings) -> list[str]:
    """The folders of all rigs, relative to the root."""
    layout = layout_of(settings)
    return [folder for rig in range(settings.n_rigs) for folder in layout.folders(rig)]


def is_own_folder(folder: str) -> bool:
    """Whether a simulation may write, and so replace, a folder of this name.

    >>> [is_own_folder(name) for name in ("2041_01_02", "data/sim_0007", "../thesis", "data")]
    [True, True, False, False]
    """
    return _FOLDER.fullmatch(folder) is not None
