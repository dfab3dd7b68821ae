"""The LiDAR moves in its mount: what changes, by how much, and what must stay as it was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from numpy.typing import NDArray
from omegaconf import OmegaConf

from uncal.errors import ConfigurationError, RecordingError
from uncal.geometry import matrix_to_pose
from uncal.geometry.decalibration import correct, decalibrate
from uncal.recordings.dsec import Dsec
from uncal.recordings.frame import Frame
from uncal.recordings.kitti import KittiRaw
from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.formats.kitti_folder import KittiLayout
from uncal.simulation.rigid import Matrix, inverse, pose_matrix
from uncal.simulation.scene.trajectory import vehicle_pose
from uncal.simulation.scene.triangle_scene import NOTHING, Scene
from uncal.simulation.sensors.mount_motion import TRUTH_NAME, lidar_motion, read_truth
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.sensors.view import View
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]

FIRST, FRAMES = 2, 4
DRIVE = "2041_01_01/2041_01_01_drive_0001_sync"
DOF = ("x_cm", "y_cm", "z_cm", "roll_deg", "pitch_deg", "yaw_deg")
STILL = {
    **dict.fromkeys(DOF, 0.0),
    **{"first_frame": FIRST, "ramp_frames": 1},
    **{"vibration_cm": 0.0, "vibration_deg": 0.0, "vibration_hz": 7.3},
}
EXACT = {
    **{"beams": 32, "azimuth_step_deg": 0.5, "motion_distortion": False},
    **{"range_noise_m": 0.0, "range_bias_m": 0.0, "dropout": 0.0},
}


def moving(make: MakeSettings, **motion: float) -> SimulationSettings:
    return make(n_rigs=1, frames_per_drive=FRAMES, lidar=EXACT, motion=STILL | motion)


@pytest.fixture(scope="module")
def roots(make_settings: MakeSettings, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same rig at rest, with a motion of size zero, and with one that can be seen."""
    folder = tmp_path_factory.mktemp("moving")
    every = {
        "rest": make_settings(n_rigs=1, frames_per_drive=FRAMES, lidar=EXACT),
        "zero": moving(make_settings),
        "yaw": moving(make_settings, yaw_deg=3.0, y_cm=20.0),
    }
    for name, settings in every.items():
        ensure_simulated(settings, folder / name, workers=1, progress=False)
    return {name: folder / name for name in every}


def test_without_motion_nothing_is_new(make_settings: MakeSettings) -> None:
    tiny = make_settings()
    assert "motion" not in tiny.as_dict()
    # Of before there were motions: folders simulated then are still found and reused.
    assert tiny.fingerprint() == "fe5bf06e62641c08"
    street = OmegaConf.to_container(OmegaConf.load(Path(CONFIG_DIR) / "simulation/street.yaml"))
    shipped = SimulationSettings.from_mapping(cast("dict[str, object]", street))
    assert shipped.fingerprint() == "2868283d098b041a"


def test_motion_counts_and_survives_a_round_trip(make_settings: MakeSettings) -> None:
    settings = moving(make_settings, x_cm=5.0)
    assert SimulationSettings.from_mapping(settings.as_dict()) == settings
    assert settings.fingerprint() != moving(make_settings, x_cm=6.0).fingerprint()
    assert settings.fingerprint() != make_settings(n_rigs=1, frames_per_drive=4).fingerprint()


def test_only_the_scans_after_the_step_change(roots: dict[str, Path]) -> None:
    contents = {
        name: {
            str(path.relative_to(root)): path.read_bytes()
            for path in root.rglob("*")
            if path.is_file() and path.suffix in (".png", ".bin", ".txt")
        }
        for name, root in roots.items()
    }
    truth = f"{DRIVE}/{TRUTH_NAME}"
    assert truth not in contents["rest"]
    for name in ("zero", "yaw"):
        assert contents[name].pop(truth)
        assert contents[name].keys() == contents["rest"].keys()
    assert contents["zero"] == contents["rest"]
    changed = {name for name, was in contents["rest"].items() if contents["yaw"][name] != was}
    scans = f"{DRIVE}/velodyne_points/data"
    assert changed == {f"{scans}/{frame:010d}.bin" for frame in range(FIRST, FRAMES)}


def test_truth_is_beside_and_readers_see_the_nominal_extrinsic(
    make_settings: MakeSettings, roots: dict[str, Path]
) -> None:
    nominal = draw_rig(moving(make_settings), 0).T_cam_lidar
    truth = read_truth(roots["yaw"] / DRIVE)
    recording = KittiRaw(roots["yaw"])
    assert truth.shape == (FRAMES, 4, 4)
    for frame_id, true in zip(recording.frame_ids, truth, strict=True):
        assumed = recording.load(frame_id).T_cam_lidar
        np.testing.assert_allclose(assumed, nominal, atol=1e-9)
        moved = np.linalg.inv(assumed) @ true
        pose = matrix_to_pose(torch.from_numpy(moved)).numpy()
        expected = [0.0, 0.2, 0.0, 0.0, 0.0, np.deg2rad(3.0)]
        np.testing.assert_allclose(
            pose, expected if frame_id.index >= FIRST else np.zeros(6), atol=1e-9
        )
        # The decalibration that an estimator is asked for takes the assumed one to the true one.
        D = matrix_to_pose(torch.from_numpy(np.linalg.inv(moved)))
        tensors = torch.from_numpy(assumed), torch.from_numpy(true)
        torch.testing.assert_close(correct(tensors[0], D), tensors[1])
        torch.testing.assert_close(decalibrate(tensors[1], D), tensors[0])


def disagreement(
    scene: Scene, T_world_cam: Matrix, points: NDArray[np.float32], T_cam_lidar: Matrix
) -> float:
    """Mean relative error, at most 0.2 each, of depth in the camera with this extrinsic."""
    seen = points[:, :3] @ T_cam_lidar[:3, :3].T + T_cam_lidar[:3, 3]
    seen = seen[(seen[:, 2] > 1) & (np.abs(seen[:, 0]) < 0.5 * seen[:, 2])]
    directions = (seen / seen[:, 2:] @ T_world_cam[:3, :3].T).astype(np.float32)
    origins = np.tile(T_world_cam[:3, 3].astype(np.float32), (len(seen), 1))
    triangle = scene.cast(origins, directions)
    depth = View(scene, T_world_cam[:3, 3]).meet(triangle, directions.T.copy()).t
    error = np.where(triangle == NOTHING, 1.0, np.abs(depth / seen[:, 2] - 1))
    assert len(error) > 500
    return float(np.minimum(error, 0.2).mean())


@pytest.mark.parametrize(
    ("dof", "size"),
    [("x_cm", 40), ("y_cm", -30), ("z_cm", 30), ("roll_deg", 4), ("pitch_deg", 2), ("yaw_deg", -2)],
)
def test_the_scan_is_displaced_by_the_known_amount(
    make_settings: MakeSettings, tmp_path: Path, dof: str, size: float
) -> None:
    settings = moving(make_settings, **{dof: float(size)})
    folder = tmp_path / DRIVE
    piece, layout = Piece(0, 0, 0, FRAMES), KittiLayout(settings)
    layout.prepare(0, tmp_path)
    layout.write(piece, tmp_path)
    recording, truth = KittiRaw(tmp_path), read_truth(folder)
    rig = draw_rig(settings, 0)
    street, scene = build_scene(settings, piece)
    unit = np.zeros(6)
    unit[DOF.index(dof)] = size * (0.01 if dof.endswith("cm") else np.pi / 180)
    for frame in (FIRST - 1, FIRST, FRAMES - 1):
        loaded = recording.load(recording.frame_ids[frame])
        T_world_lidar = vehicle_pose(settings, street, 0, 0, frame) @ rig.T_vehicle_lidar
        T_world_cam = T_world_lidar @ inverse(rig.T_cam_lidar)

        def off(T_cam_lidar: Matrix, of: Frame = loaded, at: Matrix = T_world_cam) -> float:
            return disagreement(scene, at, of.points, T_cam_lidar)

        found = {
            share: off(loaded.T_cam_lidar @ pose_matrix(share * unit[:3], share * unit[3:]))
            for share in (-1.0, 0.0, 0.5, 1.0, 1.5)
        }
        expected = 1.0 if frame >= FIRST else 0.0
        assert min(found, key=lambda share: found[share]) == expected, found
        assert off(truth[frame]) == pytest.approx(found[expected], abs=1e-4)
        # The two sensors see different edges: not zero, but far from what a motion does.
        assert found[expected] < 0.6 * found[-1.0 if expected else 1.0]


def test_ramp_and_vibration(make_settings: MakeSettings) -> None:
    settings = make_settings(
        frames_per_drive=9, motion=STILL | {"x_cm": 8.0, "ramp_frames": 4, "first_frame": 3}
    )
    x = [lidar_motion(settings, 0, 0, frame)[0, 3] for frame in range(9)]
    np.testing.assert_allclose(x, [0, 0, 0, 0.02, 0.04, 0.06, 0.08, 0.08, 0.08], atol=1e-12)

    shaking = make_settings(
        frames_per_drive=400, motion=STILL | {"vibration_cm": 2.0, "vibration_deg": 0.5}
    )
    motions = np.stack([lidar_motion(shaking, 0, 0, frame) for frame in range(2, 400)])
    poses = matrix_to_pose(torch.from_numpy(motions)).numpy()
    amplitude = np.array([0.02] * 3 + [np.deg2rad(0.5)] * 3)
    assert (np.abs(poses) <= amplitude * 1.0001).all()
    # Of a sine: the root of its mean square is amplitude / √2, its mean 0.
    np.testing.assert_allclose(poses.std(0), amplitude / np.sqrt(2), rtol=0.1)
    assert (np.abs(poses.mean(0)) < 0.1 * amplitude).all()
    assert np.abs(np.corrcoef(poses.T) - np.eye(6)).max() < 0.9999
    assert not np.allclose(lidar_motion(shaking, 0, 1, 5), lidar_motion(shaking, 0, 0, 5))


def test_dsecs_layout_has_it_too(make_event_settings: MakeSettings, tmp_path: Path) -> None:
    rest = {"n_rigs": 1, "frames_per_drive": 2, "drives_per_rig": 2}
    settings = make_event_settings(**rest, motion=STILL | {"first_frame": 1, "z_cm": 30.0})
    ensure_simulated(settings, tmp_path / "moved", workers=1, progress=False)
    ensure_simulated(make_event_settings(**rest), tmp_path / "rest", workers=1, progress=False)
    truth = read_truth(tmp_path / "moved" / "sim_0000_b")
    nominal = draw_rig(settings, 0).T_cam_lidar
    np.testing.assert_allclose(truth[0], nominal, atol=1e-9)
    np.testing.assert_allclose(truth[1], nominal @ pose_matrix((0, 0, 0.3), (0, 0, 0)), atol=1e-9)
    moved, still = (
        Dsec(tmp_path / name, window_ms=50.0, min_events=1) for name in ("moved", "rest")
    )
    assert not list((tmp_path / "rest").rglob(TRUTH_NAME))
    for index, frame_id in enumerate(moved.frame_ids):
        a, b = moved.load(frame_id), still.load(frame_id)
        np.testing.assert_array_equal(a.T_cam_lidar, b.T_cam_lidar)
        assert a.events is not None
        assert b.events is not None
        np.testing.assert_array_equal(a.events.t, b.events.t)
        assert np.array_equal(a.points, b.points) == (index % 2 == 0)


@pytest.mark.parametrize("name", ["step", "ramp", "vibration"])
def test_yaml_of_a_motion(name: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("simulate", [f"+simulation/motion={name}"])
        dataset = compose("train", [f"+simulation/motion@dataset.simulation.motion={name}"])
    assert dataset.dataset.simulation.motion == config.simulation.motion
    plain = cast("dict[str, object]", OmegaConf.to_container(config.simulation, resolve=True))
    settings = SimulationSettings.from_mapping(plain)
    assert not np.allclose(lidar_motion(settings, 0, 0, settings.frames_per_drive - 1), np.eye(4))


def test_a_motion_that_cannot_be_is_refused(make_settings: MakeSettings, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"motion\.first_frame is 3; it must be smaller"):
        make_settings(motion=STILL | {"first_frame": 3})
    with pytest.raises(ConfigurationError, match=r"motion\.yaw_deg=11\.0: expected a number from"):
        make_settings(motion=STILL | {"yaw_deg": 11.0})
    with pytest.raises(ConfigurationError, match=r"missing setting simulation\.motion\.x_cm"):
        make_settings(motion={name: value for name, value in STILL.items() if name != "x_cm"})
    with pytest.raises(RecordingError, match=r"true_T_cam_lidar\.txt cannot be read"):
        read_truth(tmp_path)
