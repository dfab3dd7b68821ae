"""The simulated event recordings, read by the reader of real ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import hdf5plugin  # noqa: F401  # registers Blosc
import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.recordings.dsec import Dsec
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.formats.dsec_folder import sweep_times
from uncal.simulation.scene.trajectory import pose_around, turn_rates, vehicle_pose
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.event_camera import LuminanceMeter
from uncal.simulation.sensors.event_optics import draw_optics
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]


@pytest.fixture(scope="module")
def recording(event_simulation: Path) -> Dsec:
    return Dsec(event_simulation, window_ms=50.0, min_events=100)


def test_the_reader_of_real_recordings_finds_every_frame(
    recording: Dsec, event_settings: SimulationSettings
) -> None:
    assert recording.skipped == {}
    assert len(recording.frame_ids) == event_settings.n_frames
    assert {frame_id.drive for frame_id in recording.frame_ids} == {
        f"sim_000{index}_{letter}" for index in range(2) for letter in "ab"
    }
    assert len({frame_id.rig for frame_id in recording.frame_ids}) == 2
    for frame_id in recording.frame_ids:
        index = int(frame_id.drive[4:8])
        frame = recording.load(frame_id)
        rig = draw_rig(event_settings, index)
        np.testing.assert_allclose(frame.T_cam_lidar, rig.T_cam_lidar, atol=1e-9)
        np.testing.assert_allclose(frame.K, rig.K, atol=1e-9)
        assert frame.points[:, 3].max() <= 1.0
        assert frame.events is not None
        assert frame.events.size == (24, 64)
        start, end = frame.events.window
        sequence = ord(frame_id.drive[-1]) - ord("a")
        assert end == sweep_times(event_settings, sequence)[frame_id.index]
        assert start == end - 50_000
        assert start <= frame.events.t[0] <= frame.events.t[-1] < end
        # Spread over the whole window: it has been simulated from its beginning.
        assert np.histogram(frame.events.t, 5, (start, end))[0].min() > 20


def test_rectified_events_are_where_the_map_puts_them(
    recording: Dsec, event_settings: SimulationSettings
) -> None:
    rectify_map = draw_optics(event_settings, 0, draw_rig(event_settings, 0)).rectify_map((24, 64))
    allowed = {tuple(pair) for pair in rectify_map.reshape(-1, 2).tolist()}
    events = recording.load(recording.frame_ids[0]).events
    assert events is not None
    found = set(zip(events.x.tolist(), events.y.tolist(), strict=True))
    assert found <= allowed
    assert not found & {(float(x), float(y)) for x in range(64) for y in range(24)}


def test_rectified_events_lie_on_what_a_straight_camera_sees_change(
    make_event_settings: MakeSettings, tmp_path: Path
) -> None:
    settings = make_event_settings(
        n_rigs=1,
        frames_per_drive=2,
        camera={"height": 80, "width": 208, "focal_px": 230.0},
        events={"noise_hz": 0.0},
    )
    ensure_simulated(settings, tmp_path / "root", workers=1, progress=False)
    recording = Dsec(tmp_path / "root", window_ms=50.0, min_events=100)
    with h5py.File(tmp_path / "root/sim_0000_a/events/left/events.h5") as file:
        raw = {name: file[f"events/{name}"][1:-1].astype(float) for name in "xy"}
    rig, (street, scene) = draw_rig(settings, 0), build_scene(settings, Piece(0, 0, 0, 2))
    v, u = np.mgrid[:80, :208]
    rays = np.stack([u, v, np.ones(u.shape)], -1) @ np.linalg.inv(rig.K).T
    meter = LuminanceMeter(scene, settings.camera, rays.astype(np.float32))
    T_vehicle_cam = rig.T_vehicle_lidar @ np.linalg.inv(rig.T_cam_lidar)
    read = 0
    for frame_id in recording.frame_ids:
        now = vehicle_pose(settings, street, 0, 0, frame_id.index)
        assert settings.events is not None
        motion = generator(settings.seed, Stream.MOTION, 0, 0, frame_id.index)
        before = pose_around(settings, now, turn_rates(settings.events, motion), -0.05)
        light = [np.log(meter.measure(pose @ T_vehicle_cam) + 0.02) for pose in (before, now)]
        expected = np.abs(light[1] - light[0])
        events = recording.load(frame_id).events
        assert events is not None
        part = slice(read, read + len(events))
        read += len(events)
        right = agreement(expected, events.x, events.y, events.p)
        assert right > 0.6
        assert agreement(expected, raw["x"][part], raw["y"][part], events.p) < right - 0.15


def agreement(
    expected: NDArray[np.floating],
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    p: NDArray[np.bool_],
) -> float:
    """Correlation of an expected change and what the events, put on whole pixels, add up to."""
    height, width = expected.shape
    column, row = np.round(x).astype(int), np.round(y).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    counted = np.zeros(expected.shape)
    np.add.at(counted, (row[inside], column[inside]), np.where(p[inside], 1.0, -1.0))
    return float(np.corrcoef(expected.ravel(), np.abs(counted).ravel())[0, 1])
