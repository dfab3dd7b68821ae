from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pykitti  # type: ignore[import-untyped]
import pytest

from uncal.errors import ConfigurationError, RecordingError
from uncal.simulation import writer
from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.scene.trajectory import drive_speed
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]


def digests(root: Path) -> dict[str, str]:
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def test_layout_is_kittis(tiny_settings: SimulationSettings, tiny_simulation: Path) -> None:
    for index, date in enumerate(["2041_01_01", "2041_01_02"]):
        raw = pykitti.raw(str(tiny_simulation), date, "0001")
        rig = draw_rig(tiny_settings, index)
        np.testing.assert_allclose(raw.calib.T_cam2_velo, rig.T_cam_lidar, atol=1e-9)
        assert len(raw.timestamps) == len(raw.cam2_files) == len(raw.velo_files) == 3
        seconds = (raw.timestamps[1] - raw.timestamps[0]).total_seconds()
        speed = drive_speed(tiny_settings, index, 0)
        assert seconds * speed == pytest.approx(0.4 * 12.5, rel=1e-5)
        assert np.hypot(raw.oxts[0].packet.vf, raw.oxts[0].packet.vl) == pytest.approx(
            speed, rel=1e-3
        )
        image = cv2.imread(raw.cam2_files[2])
        assert image is not None
        assert image.shape == (24, 64, 3)
        assert image.std() > 10
        points = raw.get_velo(0)
        assert points.dtype == np.float32
        assert 200 < len(points) <= 16 * 120
        assert ((points[:, 3] >= 0) & (points[:, 3] <= 1)).all()
        ranges = np.linalg.norm(points[:, :3], axis=1)
        assert ranges.min() >= 1.5 - 1e-4
        assert ranges.max() <= 80.0 + 1e-4


def test_manifest_says_that_it_is_simulated(
    tiny_settings: SimulationSettings, tiny_simulation: Path
) -> None:
    manifest = json.loads((tiny_simulation / "simulation.json").read_text())
    assert manifest["simulated"] is True
    assert manifest["finished"] is True
    assert manifest["fingerprint"] == tiny_settings.fingerprint()
    assert manifest["n_frames"] == 6
    assert manifest["dates"] == ["2041_01_01", "2041_01_02"]
    assert SimulationSettings.from_mapping(manifest["settings"]) == tiny_settings


def test_rigs_drives_and_frames_differ(tiny_simulation: Path) -> None:
    found = digests(tiny_simulation)
    frames = [name for name in found if name.endswith((".png", ".bin"))]
    assert len(frames) == 2 * 3 * 2
    assert len({found[name] for name in frames}) == len(frames)
    calibrations = [found[f"{date}/calib_velo_to_cam.txt"] for date in ("2041_01_01", "2041_01_02")]
    assert calibrations[0] != calibrations[1]


def test_bytes_depend_on_the_seed_and_not_on_the_processes(
    make_settings: MakeSettings,
    tiny_settings: SimulationSettings,
    tiny_simulation: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ensure_simulated(tiny_settings, tmp_path / "again", workers=1, progress=False)
    assert digests(tmp_path / "again") == digests(tiny_simulation)
    ensure_simulated(make_settings(seed=1), tmp_path / "other", workers=1, progress=False)
    before, after = digests(tiny_simulation), digests(tmp_path / "other")
    assert before.keys() == after.keys()
    same = {name for name in before if before[name] == after[name]}
    assert {Path(name).name for name in same} <= {"timestamps.txt", "calib_imu_to_velo.txt"}


def test_long_drives_are_simulated_in_pieces(
    make_settings: MakeSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "PIECE_FRAMES", 2)
    settings = make_settings(n_rigs=1, drives_per_rig=2, frames_per_drive=5)
    ensure_simulated(settings, tmp_path / "root", workers=2, progress=False)
    date = tmp_path / "root" / "2041_01_01"
    for drive in ("0001", "0002"):
        images = sorted((date / f"2041_01_01_drive_{drive}_sync/image_02/data").iterdir())
        assert [image.name for image in images] == [f"{frame:010d}.png" for frame in range(5)]


def test_foreign_folders_are_refused(make_settings: MakeSettings, tmp_path: Path) -> None:
    (tmp_path / "2011_09_26").mkdir()
    with pytest.raises(RecordingError, match=r"no simulation\.json.*2011_09_26.*another folder"):
        ensure_simulated(make_settings(), tmp_path, progress=False)
    assert [entry.name for entry in tmp_path.iterdir()] == ["2011_09_26"]


def test_workers_must_be_positive(tiny_settings: SimulationSettings, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="workers is 0; it must be at least 1"):
        ensure_simulated(tiny_settings, tmp_path / "root", workers=0)


def test_a_failing_worker_is_reported_and_leaves_no_half_folder(
    tiny_settings: SimulationSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Workers find no drive folder, so their first write fails.
    monkeypatch.setattr(KittiLayout, "prepare", lambda layout, rig, partial: partial.mkdir())
    with pytest.raises(RecordingError, match=r"sync/image_02.*could not be written"):
        ensure_simulated(tiny_settings, tmp_path / "root", workers=1, progress=False)
    assert not list((tmp_path / "root").glob("2041*"))
