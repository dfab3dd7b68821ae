"""The experiment's cases, its watchers, and a small run of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from uncal.edges.evidence import pack
from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES, pose_to_matrix
from uncal.monitor.evidence import Evidence, EvidenceReader
from uncal.monitor.experiment.cases import FAULT, STEP, STILL, Case, Drive, ExperimentSettings
from uncal.monitor.experiment.observe import decalibration_of, exchanged, says_moved
from uncal.monitor.experiment.run import run_experiment
from uncal.monitor.reference_windows import make_references
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.statistics import STATISTICS
from uncal.monitor.verdict import Verdict
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.kitti import KittiRaw
from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.writer import ensure_simulated
from uncal.weights.shipped import find_weights

ONSET, FRAMES = 2, 9

TINY = (
    f"experiment.simulation.frames_per_drive={FRAMES}",
    "experiment.simulation.camera={height: 24, width: 64, focal_px: 70.0}",
    "experiment.simulation.lidar.beams=16",
    "experiment.simulation.lidar.azimuth_step_deg=1.0",
    "experiment.simulation.scene.view_m=60",
    "experiment.drives={still: 2, step: 2, motion: 1, fault: 1, blind: 2}",
    "experiment.step_cm=[10.0]",
    "experiment.step_deg=[1.0]",
    f"experiment.onset={ONSET}",
    "experiment.workers=1",
)


def composed(*words: str) -> DictConfig:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        return compose("monitor", ["weights=unical", "+sweeps=monitor", *words])


def test_cases_move_one_dof_each(tmp_path: Path) -> None:
    settings = ExperimentSettings.of(composed(*TINY).experiment)
    cases = settings.cases()
    steps = [case for case in cases if case.kind == STEP]
    assert [case.dof for case in steps] == list(DOF_NAMES)
    for case in steps:
        motion = case.motion
        assert motion is not None
        size = [getattr(motion, key) for key in ("x_cm", "y_cm", "z_cm")]
        size += [getattr(motion, key) for key in ("roll_deg", "pitch_deg", "yaw_deg")]
        assert np.flatnonzero(size).tolist() == [DOF_NAMES.index(case.dof)]
        assert sum(size) == case.size
        assert (motion.first_frame, motion.ramp_frames) == (ONSET, 1)
    faults = {case.name: case.fault for case in cases if case.fault is not None}
    assert len(faults) == 5
    assert {(fault.first, fault.last) for fault in faults.values()} == {(ONSET, FRAMES - 1)}
    assert [case.kind for case in cases if case.motion is None and case.fault is None] == [STILL]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("experiment.onset=9", r"experiment\.onset=9, frames=9: expected 1 <= onset <"),
        ("experiment.frames=10", r"frames=10: expected .* <= simulation\.frames_per_drive=9"),
        ("experiment.drives.step=3", r"experiment\.drives\.step=3: expected 1 to .*still=2"),
        ("experiment.drives.blind=1", r"experiment\.drives\.blind=1: expected 2 to .*step=2"),
        ("+experiment.onsets=5", r"experiment\.onsets: the experiment takes exactly"),
        ("+experiment.motions.ramp.w_cm=5", r"unknown setting simulation\.motion\.w_cm"),
    ],
)
def test_settings_that_cannot_be_are_refused(word: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        ExperimentSettings.of(composed(*TINY, word).experiment).cases()


def test_decalibration_is_what_a_correction_takes_out() -> None:
    D = torch.tensor([0.05, -0.02, 0.01, 0.01, -0.02, 0.005], dtype=torch.float64)
    true = pose_to_matrix(torch.tensor([0.1, 0.2, 0.3, 1.5, 0.1, -1.5], dtype=torch.float64))
    found = decalibration_of((true @ pose_to_matrix(D)).numpy(), true.numpy())
    np.testing.assert_allclose(found, D.numpy(), atol=1e-12)


def verdict(**changes: Any) -> Verdict:  # noqa: ANN401  # any field of it
    zero, line = np.zeros(6), np.full(6, np.inf)
    given = {
        **{"frame": "", "time": 0.0, "correction": zero, "lower": -line, "upper": line},
        **{"sigma": zero, "joint_lower": -line, "joint_upper": line, "verdict": "ok", "reason": ""},
        **{"extrinsic": np.eye(4), "updated": False, "frames": 2, "wealth": 1.0},
    }
    return Verdict(**{**given, **changes})


def test_wide_intervals_do_not_say_that_something_moved() -> None:
    limit = np.full(6, 0.08)
    away = np.array([0.01, *[-np.inf] * 5])
    assert not says_moved(verdict(verdict="recalibrate"), limit)
    assert says_moved(verdict(verdict="drifting", joint_lower=away), limit)
    assert says_moved(verdict(verdict="recalibrate", correction=np.full(6, -0.09)), limit)
    assert not says_moved(verdict(verdict="untrusted", joint_lower=away), limit)


def test_images_are_exchanged_and_nothing_else() -> None:
    drives = [
        Drive(
            name,
            [
                Frame(
                    id=FrameId("rig", name, number),
                    image=np.full((2, 3, 3), 10 * place + number, np.uint8),
                    points=np.full((5, 4), place, np.float32),
                    K=np.eye(3) * (place + 1),
                    T_cam_lidar=np.eye(4),
                    time=0.0,
                )
                for number in range(2)
            ],
            np.stack([np.eye(4)] * 2),
        )
        for place, name in enumerate("ab")
    ]
    for place, drive in enumerate(drives):
        frames = exchanged(drive, drives[1 - place])
        for number, (frame, own) in enumerate(zip(frames, drive.frames, strict=True)):
            assert frame.image is drives[1 - place].frames[number].image
            assert (frame.points, frame.K, frame.id) == (own.points, own.K, own.id)


@pytest.fixture
def seeing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that knows the truth of a frame, but only if it gets the frame's own image."""
    known: dict[bytes, tuple[np.ndarray, np.ndarray | None]] = {}
    recorded = ExperimentSettings.recorded

    def registering(self: ExperimentSettings, case: Case, number: int) -> Drive:
        drive = recorded(self, case, number)
        for frame, truth in zip(drive.frames, drive.truth, strict=True):
            known[frame.points.tobytes()] = truth, frame.image
        return drive

    def evidence(self: EvidenceReader, frame: Frame, T: np.ndarray, *rest: object) -> Evidence:
        truth, image = known.get(frame.points.tobytes(), (frame.T_cam_lidar, frame.image))
        assert frame.image is not None
        information = 1e4 if image is not None and np.array_equal(frame.image, image) else 0.0
        D = torch.from_numpy(decalibration_of(T, truth) / self.bounds).float()
        return Evidence(
            pack(information * torch.eye(6), information * D)[None], np.ones(len(STATISTICS))
        )

    monkeypatch.setattr(ExperimentSettings, "recorded", registering)
    monkeypatch.setattr(EvidenceReader, "evidence", evidence)


def test_with_a_reader_that_knows_the_truth(tmp_path: Path, seeing: None) -> None:
    """Every number is known beforehand, and a camera's image is what makes the difference."""
    words = ["window=2", "level=0.5", "exchangeable=window", "sensors.min_points=100"]
    config = composed(*TINY, *words, f"experiment.root={tmp_path / 'data'}")
    settings = ExperimentSettings.of(config.experiment)
    monitor = MonitorSettings.of(cast("dict[str, object]", OmegaConf.to_container(config)))
    other = replace(settings.simulation, seed=5, n_rigs=2)
    ensure_simulated(other, tmp_path / "references", 1)
    reader = EvidenceReader(find_weights("unical"), torch.device("cpu"), monitor.seed)
    references = make_references(KittiRaw(tmp_path / "references"), reader, monitor, "small")
    config.references = str(references.save(tmp_path / "small.npz"))
    page = run_experiment(config, tmp_path, "python -m …")

    assert (tmp_path / "monitor.md").read_text(encoding="utf-8") == page
    figure = (tmp_path / "monitor_steps.png").read_bytes()
    # Killed before its end it goes on: what is there is not measured again.
    parts = sorted((tmp_path / "observations").glob("*.csv"))
    untouched = {path: path.stat().st_mtime_ns for path in parts[1:]}
    parts[0].unlink()
    assert run_experiment(config, tmp_path, "python -m …") == page
    assert (tmp_path / "monitor_steps.png").read_bytes() == figure
    assert {path: path.stat().st_mtime_ns for path in parts[1:]} == untouched
    config.window = 3
    with pytest.raises(ConfigurationError, match="window"):
        run_experiment(config, tmp_path, "python -m …")
    assert "X 10.0 cm" in page
    rows = pd.read_csv(tmp_path / "observations.csv", keep_default_na=False)
    per_case = rows[rows["watcher"] == "monitor"].groupby("kind").size()
    n = FRAMES
    assert per_case.to_dict() == {
        STILL: 2 * n,
        STEP: 12 * n,
        "ramp": n,
        "vibration": n,
        FAULT: 5 * n,
    }
    nominal = rows[[f"nominal {dof}" for dof in DOF_NAMES]].to_numpy(float)
    assert np.abs(nominal[(rows["kind"] == STILL) | (rows["number"] < ONSET)]).max() < 1e-9
    expected = np.diag([-0.1] * 3 + [-np.pi / 180] * 3)
    for j, dof in enumerate(DOF_NAMES):
        chosen = (rows["kind"] == STEP) & (rows["number"] >= ONSET) & (rows["dof"] == dof)
        found = nominal[chosen]
        np.testing.assert_allclose(found, np.tile(expected[j], (len(found), 1)), atol=1e-6)
    black = rows[(rows["case"] == "black camera") & (rows["number"] >= ONSET)]
    assert (black["verdict"] == "untrusted").all()

    detection = pd.read_csv(tmp_path / "monitor_detection.csv")
    steps = detection[detection["case"] == STEP]
    assert steps["dof"].tolist() == list(DOF_NAMES)
    for watcher in ("monitor", "single"):
        assert (steps[f"{watcher}_detected"] == 100).all()
        assert (steps[f"{watcher}_delay"] == 0).all()
    alarms = pd.read_csv(tmp_path / "monitor_alarms.csv").set_index("watcher")
    assert (alarms["alarms"] == 0).all()
    error = pd.read_csv(tmp_path / "monitor_error.csv").set_index("dof").loc[list(DOF_NAMES)]
    np.testing.assert_allclose(error["nothing_dof"], [10, 10, 10, 1, 1, 1], rtol=1e-6)
    assert (error["monitor_dof"] < 0.6 * error["nothing_dof"]).all()
    assert (error["single_dof"] < 0.01 * error["nothing_dof"]).all()
    updates = pd.read_csv(tmp_path / "monitor_updates.csv").set_index("kind")
    assert updates.loc[STEP, "updates"] > 0
    assert updates.loc[STEP, "harmful"] == updates.loc[STILL, "updates"] == 0
    blind = pd.read_csv(tmp_path / "monitor_blind.csv").set_index("watcher")
    np.testing.assert_allclose(blind.loc["monitor", "response"], 1.0, atol=0.01)
    np.testing.assert_allclose(blind.loc["blind", "response"], 0.0, atol=0.01)
    assert (blind.loc["blind", "alarmed_after"] == 0).all()
