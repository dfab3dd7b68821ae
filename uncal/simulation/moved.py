"""Drives in which the LiDAR moves, out of the same drives at rest: only moved scans are made anew.

Photographs take most of a simulation's time, and the motion of a LiDAR does not change them.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from uncal.simulation.cache import discard
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.formats.kitti_folder import KittiLayout, drive_name
from uncal.simulation.manifest import LOCK_NAME, Manifest, read_manifest
from uncal.simulation.scene.street import Street
from uncal.simulation.scene.trajectory import drive_speed, vehicle_pose
from uncal.simulation.scene.triangle_scene import Scene
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.mount_motion import lidar_motion
from uncal.simulation.sensors.rig import draw_rig, rig_date
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import PARTIAL_PREFIX, PIECE_FRAMES, publish
from uncal.system.locking import locked

log = logging.getLogger(__name__)


def ensure_moved(settings: SimulationSettings, still: Path, root: Path) -> Path:
    """Make ``root`` hold exactly this simulation, as :func:`ensure_simulated` does, but faster.

    Args:
        settings: with a motion; KITTI layout.
        still: a finished simulation of the same settings without motion, of at least as many rigs.
        root: folder of the simulation.

    Returns:
        ``root``.

    Raises:
        RecordingError: ``root`` holds something that the simulator did not write.
    """
    read_manifest(root)
    root.mkdir(parents=True, exist_ok=True)
    layout = KittiLayout(settings)
    with locked(root / LOCK_NAME, f"simulates into {root}"):
        present = read_manifest(root)
        if present is not None and present.fingerprint != settings.fingerprint():
            discard(root, present, settings)
            present = None
        missing = [rig for rig in range(settings.n_rigs) if not layout.is_complete(rig, root)]
        if present is not None and present.finished and not missing:
            return root
        Manifest.of(settings, finished=False).write(root)
        for rig in missing:
            partial = root / f"{PARTIAL_PREFIX}{rig:04d}"
            if partial.exists():
                shutil.rmtree(partial)
            layout.prepare(rig, partial)
            for drive in range(settings.drives_per_rig):
                _write_drive(settings, rig, drive, still, partial)
            publish(layout, rig, partial, root)
        Manifest.of(settings, finished=True).write(root)
        log.info("%s: scans of %d rigs", root, len(missing))
    return root


def _write_drive(
    settings: SimulationSettings, rig: int, drive: int, still: Path, root: Path
) -> None:
    date = rig_date(rig)
    place = Path(date) / drive_name(date, drive)
    built = draw_rig(settings, rig)
    lidar = Lidar(settings.lidar, built.elevations, built.range_bias, built.gain)
    speed = drive_speed(settings, rig, drive)
    onset = settings.frames_per_drive if settings.motion is None else settings.motion.first_frame
    # The generator of a photograph is its own, so that a copy is what would have been written.
    for name in ("image_02", "oxts"):
        shutil.copytree(still / place / name, root / place / name, dirs_exist_ok=True)
    for frame in range(settings.frames_per_drive):
        file = Path("velodyne_points") / "data" / f"{frame:010d}.bin"
        if frame < onset:
            shutil.copyfile(still / place / file, root / place / file)
            continue
        street, scene = _scene(replace(settings, motion=None), rig, drive, frame // PIECE_FRAMES)
        pose = vehicle_pose(settings, street, rig, drive, frame) @ built.T_vehicle_lidar
        points = lidar.sweep(
            scene,
            pose @ lidar_motion(settings, rig, drive, frame),
            generator(settings.seed, Stream.LIDAR, rig, drive, frame),
            velocity=speed * pose[:3, 0],
        )
        (root / place / file).write_bytes(points.tobytes())


@lru_cache(maxsize=4)
def _scene(settings: SimulationSettings, rig: int, drive: int, piece: int) -> tuple[Street, Scene]:
    """Of the frames that the simulator writes at a time; shared by all motions of a drive."""
    first = piece * PIECE_FRAMES
    last = min(first + PIECE_FRAMES, settings.frames_per_drive)
    return build_scene(settings, Piece(rig, drive, first, last))
