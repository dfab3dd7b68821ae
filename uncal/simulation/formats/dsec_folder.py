"""Simulated rigs in the layout of DSEC: every rig one drive, its drives that drive's sequences."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uncal.simulation.formats.drive import Piece
from uncal.simulation.formats.dsec_drive import (
    Recorded,
    midnight_us,
    sweep_times,
    window_us,
    write_part,
)
from uncal.simulation.formats.dsec_files import (
    DsecCamera,
    LidarScan,
    write_cam_to_cam,
    write_cam_to_lidar,
    write_events,
    write_lidar_bag,
    write_rectify_map,
)
from uncal.simulation.sensors.event_optics import FRAME_SCALE, EventOptics, draw_optics
from uncal.simulation.sensors.mount_motion import write_truth
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings

PARTS = "parts"
"""Folder for what the pieces record, until the rig is finished."""

LEAD_US = 10_000
"""A sequence's events begin this long before its first window and end this long after its last."""

FULL_INTENSITY = 255
"""What DSEC's LiDAR reports for a reflectance of 1."""


def recording_drive(rig: int) -> str:
    """Name of the drive of a rig: the folder of its LiDAR bag.

    >>> recording_drive(7), sequence_name(7, 0)
    ('sim_0007', 'sim_0007_a')
    """
    return f"sim_{rig:04d}"


def sequence_name(rig: int, sequence: int) -> str:
    """Name of a sequence: the drive's and a letter."""
    return f"{recording_drive(rig)}_{chr(ord('a') + sequence)}"


@dataclass(frozen=True)
class DsecLayout:
    """DSEC: a folder per sequence, and one with the LiDAR of the drive they are part of.

    See :mod:`uncal.simulation.formats.layouts`. Sequences of a drive share the rig; each is
    another street.
    """

    settings: SimulationSettings

    def folders(self, rig: int) -> list[str]:
        """The LiDAR's folder first: without a sequence, a reader does not look at it."""
        sequences = range(self.settings.drives_per_rig)
        return [f"data/{recording_drive(rig)}", *(sequence_name(rig, each) for each in sequences)]

    def prepare(self, rig: int, partial: Path) -> None:
        """Create the folder for the parts; all else can wait until processes are at work."""
        (partial / PARTS).mkdir(parents=True)

    def write(self, piece: Piece, partial: Path) -> None:
        """Simulate a piece's frames into a part."""
        write_part(self.settings, piece, _part(partial, piece.drive, piece.first))

    def finish(self, rig: int, partial: Path) -> None:
        """Write the calibration, the events of every sequence, and the LiDAR bag of all."""
        optics = draw_optics(self.settings, rig, draw_rig(self.settings, rig))
        rectify_map = optics.rectify_map(self._size)
        lidar, *sequences = (partial / folder for folder in self.folders(rig))
        for sequence, folder in enumerate(sequences):
            for part in ("events/left", "calibration", "images"):
                (folder / part).mkdir(parents=True)
            self._write_events(partial, sequence, folder / "events/left/events.h5")
            write_rectify_map(folder / "events/left/rectify_map.h5", rectify_map)
            self._write_calibration(optics, folder / "calibration")
            # No pictures are simulated, but readers may look for their times.
            times = "".join(f"{time}\n" for time in sweep_times(self.settings, sequence))
            (folder / "images/timestamps.txt").write_text(times)
            write_truth(self.settings, rig, sequence, folder)
        lidar.mkdir(parents=True)
        write_lidar_bag(lidar / "lidar_imu.bag", self._scans(rig, partial))
        write_cam_to_lidar(lidar / "cam_to_lidar.yaml", optics.T_lidar_camRect1)
        shutil.rmtree(partial / PARTS)

    def is_complete(self, rig: int, root: Path) -> bool:
        """Whether every file of the rig is there; contents are not read."""
        lidar, *sequences = (root / folder for folder in self.folders(rig))
        wanted = [lidar / "lidar_imu.bag", lidar / "cam_to_lidar.yaml"]
        for folder in sequences:
            wanted += [folder / f"events/left/{name}.h5" for name in ("events", "rectify_map")]
            wanted += [
                folder / f"calibration/{name}.yaml" for name in ("cam_to_cam", "cam_to_lidar")
            ]
        return all(file.is_file() for file in wanted)

    @property
    def _size(self) -> tuple[int, int]:
        return self.settings.camera.height, self.settings.camera.width

    def _write_calibration(self, optics: EventOptics, folder: Path) -> None:
        cameras = []
        for number, rotation in enumerate(optics.R_rect):
            event = number in (0, 3)
            scale = 1 if event else FRAME_SCALE
            zoom = np.diag([scale, scale, 1.0])
            zoom[:2, 2] = (scale - 1) / 2
            cameras.append(
                DsecCamera(
                    K=zoom @ optics.K,
                    K_rect=zoom @ optics.K_rect,
                    R_rect=rotation,
                    size=(scale * self._size[0], scale * self._size[1]),
                    distortion=optics.distortion if event else (0.0, 0.0, 0.0, 0.0),
                )
            )
        steps = (optics.T_10, optics.T_21, optics.T_32)
        write_cam_to_cam(folder / "cam_to_cam.yaml", cameras, *steps)
        write_cam_to_lidar(folder / "cam_to_lidar.yaml", optics.T_lidar_camRect1)

    def _write_events(self, partial: Path, sequence: int, path: Path) -> None:
        ends = sweep_times(self.settings, sequence)
        begin, end = ends[0] - window_us(self.settings) - LEAD_US, ends[-1] + LEAD_US
        parts = [part for _, part in self._parts(partial, sequence)]
        # One event of pixel (0, 0) at either end: the span of a sequence is known by its events.
        x, y, p = (
            np.pad(np.concatenate([getattr(part, name) for part in parts]), 1) for name in "xyp"
        )
        t = np.concatenate([[begin], *(part.t for part in parts), [end]])
        write_events(path, x, y, t - begin, p, int(begin))

    def _scans(self, rig: int, partial: Path) -> Iterator[LidarScan]:
        for sequence in range(self.settings.drives_per_rig):
            times = sweep_times(self.settings, sequence) + midnight_us(rig)
            for first, part in self._parts(partial, sequence):
                ends = np.cumsum(part.points_per_frame)[:-1]
                sweeps = zip(np.split(part.points, ends), np.split(part.ring, ends), strict=True)
                for time, (points, ring) in zip(times[first:], sweeps, strict=False):
                    points[:, 3] *= FULL_INTENSITY
                    # The simulated sweep is taken at one moment.
                    yield LidarScan(
                        int(time) * 1000, points, ring, np.zeros(len(points), np.float32)
                    )

    def _parts(self, partial: Path, sequence: int) -> Iterator[tuple[int, Recorded]]:
        """The parts of a sequence with their first frames, in order."""
        first = 0
        while first < self.settings.frames_per_drive:
            part = Recorded.read(_part(partial, sequence, first))
            yield first, part
            first += len(part.points_per_frame)


def _part(partial: Path, sequence: int, first: int) -> Path:
    return partial / PARTS / f"{sequence:02d}_{first:06d}.npz"
