from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uncal.simulation.rigid import inverse
from uncal.simulation.sensors.rig import CAMERA_FROM_LIDAR_AXES, NOMINAL_CAMERA_IN_LIDAR, draw_rig
from uncal.simulation.settings import SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def test_without_variation_the_rig_is_nominal(make_settings: MakeSettings) -> None:
    keys = ("rotation_deg", "translation_cm", "focal_percent", "principal_point_px")
    rig = draw_rig(make_settings(rig=dict.fromkeys(keys, 0.0)), 5)
    T_lidar_cam = inverse(rig.T_cam_lidar)
    assert T_lidar_cam[:3, 3].tolist() == pytest.approx(NOMINAL_CAMERA_IN_LIDAR)
    np.testing.assert_allclose(rig.T_cam_lidar[:3, :3], CAMERA_FROM_LIDAR_AXES[:3, :3], atol=1e-12)
    # Centre of a 64 × 24 image when integers are pixel centres.
    assert rig.K.tolist() == [[70, 0, 31.5], [0, 70, 11.5], [0, 0, 1]]


def test_variation_stays_within_its_bounds_and_uses_them(make_settings: MakeSettings) -> None:
    settings = make_settings(rig={"rotation_deg": 3.0, "translation_cm": 15.0})
    offsets, angles, focals = [], [], []
    for index in range(300):
        rig = draw_rig(settings, index)
        T = inverse(rig.T_cam_lidar) @ CAMERA_FROM_LIDAR_AXES
        offsets.append(T[:3, 3] - NOMINAL_CAMERA_IN_LIDAR)
        angles.append([np.arctan2(T[2, 1], T[2, 2]), np.arcsin(-T[2, 0]), np.arctan2(*T[1::-1, 0])])
        focals.append(rig.K[0, 0])
    assert (np.abs(offsets).max(0) > 0.14).all()
    assert (np.abs(offsets) <= 0.15).all()
    assert (np.rad2deg(np.abs(angles)).max(0) > 2.9).all()
    assert (np.rad2deg(np.abs(angles)) <= 3.0).all()
    assert 70 * 0.97 <= min(focals) < 70 * 0.975
    assert 70 * 1.025 < max(focals) <= 70 * 1.03


def test_kitti_chain_gives_the_true_extrinsic(tiny_settings: SimulationSettings) -> None:
    rig = draw_rig(tiny_settings, 1)
    T2, R = np.eye(4), np.eye(4)
    T2[0, 3] = rig.baseline_m
    R[:3, :3] = rig.R_rect
    np.testing.assert_allclose(T2 @ R @ rig.T_cam0_lidar, rig.T_cam_lidar, atol=1e-12)
    assert not np.allclose(rig.R_rect, np.eye(3), atol=1e-3)
    assert rig.baseline_m > 0.04


def test_beams_lie_between_the_limits_in_order(make_settings: MakeSettings) -> None:
    elevations = np.rad2deg(draw_rig(make_settings(lidar={"hdl64": False}), 0).elevations)
    assert len(elevations) == 16
    assert (np.diff(elevations) > 0).all()
    np.testing.assert_allclose(elevations, np.linspace(-24.8, 2.0, 16), atol=0.3)


def test_a_hdl64_has_two_blocks_of_lasers(make_settings: MakeSettings) -> None:
    lidar = {"hdl64": True, "beams": 64, "beam_jitter_deg": 0.0}
    elevations = np.rad2deg(draw_rig(make_settings(lidar=lidar), 0).elevations)
    assert len(elevations) == 64
    np.testing.assert_allclose(elevations[[0, 31, 32, 63]], [-24.33, -8.83, -8.33, 2.0])
    np.testing.assert_allclose(np.diff(elevations[:33]), 0.5)
    np.testing.assert_allclose(np.diff(elevations[32:]), 1 / 3, atol=1e-3)
    few = np.rad2deg(draw_rig(make_settings(lidar=lidar | {"beams": 16}), 0).elevations)
    np.testing.assert_allclose(few[[0, -1]], [-24.33, 2.0])
    np.testing.assert_allclose(few[5], elevations[21])


def test_range_biases_are_the_rigs_own_and_within_their_bound(make_settings: MakeSettings) -> None:
    settings = make_settings(lidar={"range_bias_m": 0.02})
    biases = np.array([draw_rig(settings, index).range_bias for index in range(40)])
    assert biases.shape == (40, 16)
    assert 0.019 < np.abs(biases).max() <= 0.02
    assert len(np.unique(biases)) == biases.size
    assert (draw_rig(make_settings(lidar={"range_bias_m": 0.0}), 0).range_bias == 0).all()
