"""Drives in which the LiDAR moves, out of the same drives at rest: only moved scans are made anew.

Photographs take most of a simulation's time, and the motion of a LiDAR does not change them.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.formats.kitti_folder import KittiLayout, scan_file
from uncal.simulation.manifest import PARTIAL_PREFIX, missing_rigs
from uncal.simulation.scene.trajectory import vehicle_pose
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import pieces_of, publish

log = logging.getLogger(__name__)

_scene = lru_cache(maxsize=4)(build_scene)
"""Shared by all motions of a drive."""


def ensure_moved(settings: SimulationSettings, still: Path, root: Path) -> Path:
    """Make ``root`` hold exactly this simulation, as :func:`ensure_simulated` does, but faster.

    Args:
        settings: with a motion; KITTI layout.
        still: a finished simulation of the same settings without motion, of at least as many rigs.
        root: folder of the simulation, which is returned.

    Raises:
        RecordingError: ``root`` holds something that the simulator did not write.
    """
    layout = KittiLayout(settings)
    with missing_rigs(settings, root) as missing:
        for rig in missing:
            partial = root / f"{PARTIAL_PREFIX}{rig:04d}"
            layout.prepare(rig, partial)
            for drive in range(settings.drives_per_rig):
                # The generator of a photograph is its own: a copy is what would be written.
                for name in ("image_02", "oxts"):
                    source = layout.drive_folder(rig, drive) / name
                    shutil.copytree(still / source, partial / source, dirs_exist_ok=True)
            for piece in pieces_of(settings, rig):
                _write_scans(layout, piece, still, partial)
            publish(layout, rig, partial, root)
            log.info("%s: scans of rig %d", root, rig)
    return root


def _write_scans(layout: KittiLayout, piece: Piece, still: Path, root: Path) -> None:
    settings, folder = layout.settings, layout.drive_folder(piece.rig, piece.drive)
    rig = draw_rig(settings, piece.rig)
    lidar = Lidar(settings.lidar, rig.elevations, rig.range_bias, rig.gain)
    onset = settings.frames_per_drive if settings.motion is None else settings.motion.first_frame
    for frame in range(piece.first, piece.last):
        path = folder / scan_file(frame)
        if frame < onset:
            shutil.copyfile(still / path, root / path)
            continue
        street, scene = _scene(replace(settings, motion=None), piece)
        key = (piece.rig, piece.drive, frame)
        pose = vehicle_pose(settings, street, *key) @ rig.T_vehicle_lidar
        (root / path).write_bytes(layout.sweep(scene, lidar, pose, key)[0].tobytes())
