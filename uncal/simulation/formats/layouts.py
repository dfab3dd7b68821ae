"""Which layout a simulation is written in, and which folders are its own.

A layout prepares a rig, its pieces are written by any number of processes, and it is finished, all
in a folder ``partial`` that mirrors the root; then its folders move to the root.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, TypeAlias

from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.settings import SimulationSettings

if TYPE_CHECKING:
    from uncal.simulation.formats.dsec_folder import DsecLayout

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
