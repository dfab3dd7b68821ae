from __future__ import annotations

from pathlib import Path

import numpy as np
import pykitti  # type: ignore[import-untyped]

from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings


def test_pykitti_reads_the_true_extrinsic(
    tiny_settings: SimulationSettings, tmp_path: Path
) -> None:
    rig = draw_rig(tiny_settings, 1)
    KittiLayout(tiny_settings).prepare(1, tmp_path)
    calib = pykitti.raw(str(tmp_path), rig.date, "0001").calib
    np.testing.assert_allclose(calib.T_cam2_velo, rig.T_cam_lidar, atol=1e-9)
    np.testing.assert_allclose(calib.K_cam2, rig.K, rtol=1e-11)


def test_dropping_the_rectification_would_be_noticed(tiny_settings: SimulationSettings) -> None:
    # Several readers use T_velo_to_cam alone; here that must not pass for the true extrinsic.
    rig = draw_rig(tiny_settings, 1)
    assert np.abs(rig.T_cam0_lidar - rig.T_cam_lidar)[:3, :3].max() > 2e-3
    assert np.abs(rig.T_cam0_lidar - rig.T_cam_lidar)[:3, 3].max() > 0.03


def test_every_key_of_the_real_files_is_there(
    tiny_settings: SimulationSettings, tmp_path: Path
) -> None:
    KittiLayout(tiny_settings).prepare(0, tmp_path)
    lines = (tmp_path / "2041_01_01" / "calib_cam_to_cam.txt").read_text().splitlines()
    keys = {line.split(":")[0] for line in lines}
    per_camera = ("S", "K", "D", "R", "T", "S_rect", "R_rect", "P_rect")
    expected = {f"{key}_{camera:02d}" for key in per_camera for camera in range(4)}
    assert keys == expected | {"calib_time", "corner_dist"}
    velo = (tmp_path / "2041_01_01" / "calib_velo_to_cam.txt").read_text()
    assert [line.split(":")[0] for line in velo.splitlines()] == [
        "calib_time",
        "R",
        "T",
        "delta_f",
        "delta_c",
    ]
    assert (tmp_path / "2041_01_01" / "calib_imu_to_velo.txt").is_file()
