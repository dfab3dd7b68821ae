"""A simulated drive as a bag, converted to a plain folder, is as good as it was."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from uncal.checking.check import check
from uncal.recordings.kitti import KittiRaw
from uncal.recordings.plain_folder import PlainFolder
from uncal.simulation.formats.bag import drive_as_bag


def test_bag_convert_check(kitti_like: Path, tmp_path: Path) -> None:
    source = drive_as_bag(kitti_like, "2041_*", tmp_path / "drive")
    of_bag = check(source, None, 8, None, quiet=True)
    assert of_bag.layout == "bag"
    assert of_bag.findings == []
    finished = subprocess.run(
        [sys.executable, "-m", "uncal.convert", f"source={source}", f"root={tmp_path / 'rig'}"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    assert "pairs: 6" in finished.stdout
    converted = check(tmp_path / "rig", None, 8, None, quiet=True)
    assert converted.layout == "plain folder"
    assert converted.findings == []
    before, after = KittiRaw(kitti_like), PlainFolder(tmp_path / "rig")
    one, other = before.load(before.frame_ids[3]), after.load(after.frame_ids[3])
    np.testing.assert_array_equal(one.image, other.image)
    np.testing.assert_allclose(one.points, other.points, atol=1e-6)
    np.testing.assert_allclose(one.T_cam_lidar, other.T_cam_lidar, atol=1e-9)
    np.testing.assert_allclose(one.K, other.K)
