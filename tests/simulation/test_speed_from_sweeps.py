"""A simulated drive's sweeps tell its speed, with and without a record of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uncal.recordings.dsec import Dsec
from uncal.recordings.kitti import KittiRaw
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

SEEN = {"lidar": {"beams": 32, "azimuth_step_deg": 0.4}, "scene": {"view_m": 90.0}}


def test_a_drive_without_oxts_is_untwisted_by_its_own_sweeps(
    make_settings: Callable[..., SimulationSettings], tmp_path: Path
) -> None:
    ensure_simulated(make_settings(n_rigs=1, **SEEN), tmp_path)
    recorded = KittiRaw(tmp_path)
    twists = [recorded.load(frame).twist for frame in recorded.frame_ids]
    for oxts in tmp_path.glob("*/*/oxts"):
        shutil.rmtree(oxts)
    estimated = KittiRaw(tmp_path)
    for frame, truth in zip(estimated.frame_ids, twists, strict=True):
        found = estimated.load(frame).twist
        assert truth is not None
        assert found is not None
        assert found[0] == pytest.approx(truth[0], rel=0.05)
    left = KittiRaw(tmp_path, untwist=False)
    assert left.load(left.frame_ids[0]).twist is None


def test_a_dsec_drive_is_untwisted_by_its_own_sweeps(
    make_event_settings: Callable[..., SimulationSettings], tmp_path: Path
) -> None:
    settings = make_event_settings(n_rigs=1, **SEEN)
    ensure_simulated(settings, tmp_path)
    recording = Dsec(tmp_path, window_ms=settings.events.window_ms, min_events=0)  # type: ignore[union-attr]
    found = [recording.load(frame).twist for frame in recording.frame_ids]
    speeds = [twist[0] for twist in found if twist is not None]
    assert len(speeds) == len(found)
    assert np.median(speeds) == pytest.approx(settings.vehicle.speed_mps, rel=0.05)
