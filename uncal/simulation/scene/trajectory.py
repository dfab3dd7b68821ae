"""Where the vehicle is at each frame of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix, pose_matrix
from uncal.simulation.scene.street import Street
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.settings import EventSettings, SimulationSettings


def distance_along(settings: SimulationSettings, frame: int) -> float:
    """S of the vehicle at a frame, metres from the first; constant speed."""
    return frame * settings.vehicle.speed_mps * settings.vehicle.frame_interval_s


def drive_speed(settings: SimulationSettings, rig: int, drive: int) -> float:
    """Speed during a drive, metres per second.

    Frames stay as far apart as ``speed_mps`` has them, so that what a drive sees does not depend on
    it: the time between them changes instead.
    """
    draw = generator(settings.seed, Stream.SPEED, rig, drive).uniform(-1, 1)
    return settings.vehicle.speed_mps * (1.0 + settings.vehicle.speed_variation * float(draw))


def vehicle_pose(
    settings: SimulationSettings, street: Street, rig: int, drive: int, frame: int
) -> Matrix:
    """T_world_vehicle (4, 4) at one frame: in the right lane, following the road, swaying.

    Lateral position and heading change slowly over the drive; roll, pitch and height are drawn
    anew for every frame.
    """
    limits = settings.vehicle
    s = distance_along(settings, frame)
    slow = generator(settings.seed, Stream.TRAJECTORY, rig, drive)
    phases = slow.uniform(0, 2 * np.pi, 4)
    lengths = slow.uniform(25, 90, 4)
    waves = np.sin(2 * np.pi * s / lengths + phases)
    drift = limits.drift_m * (waves[0] + waves[1]) / 2
    wander = np.deg2rad(limits.heading_deg) * (waves[2] + waves[3]) / 2
    quick = generator(settings.seed, Stream.TRAJECTORY, rig, drive, frame)
    roll, pitch = np.deg2rad(limits.attitude_deg) * quick.uniform(-1, 1, 2)
    height = limits.height_m * quick.uniform(-1, 1)
    position = street.world(np.array([s, -street.lane_m / 2 + drift, height]))
    heading = float(street.heading(s)) + wander
    return pose_matrix(position, (roll, pitch + float(street.incline(s)), heading))


def pose_around(
    settings: SimulationSettings,
    T_world_vehicle: Matrix,
    rates: NDArray[np.float64],
    seconds: float,
) -> Matrix:
    """T_world_vehicle (4, 4) ``seconds`` after a moment; (3,) turn ``rates`` in radians/s."""
    ahead = np.array([settings.vehicle.speed_mps * seconds, 0.0, 0.0])
    return T_world_vehicle @ pose_matrix(ahead, rates * seconds)


def turn_rates(events: EventSettings, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw roll, pitch and yaw rate of one window, (3,) radians per second."""
    largest = [events.sway_rate_deg_s, events.sway_rate_deg_s, events.yaw_rate_deg_s]
    return np.deg2rad(largest) * rng.uniform(-1, 1, 3)
