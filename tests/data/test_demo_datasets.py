"""The demo's variants: the same streets' number, other rigs and drives."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from uncal.recordings.frame import FrameId
from uncal.runs.assembly import build_data
from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.settings import SimulationSettings
from uncal.splits.splits import SPLITS, UNITS

TINY = [
    "dataset.simulation.frames_per_drive=1",
    "dataset.simulation.camera.supersampling=1",
    "dataset.simulation.camera.shadows=false",
    "dataset.simulation.lidar.beams=16",
    "dataset.simulation.lidar.azimuth_step_deg=2",
]


def composed(*overrides: str) -> DictConfig:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        return compose("train", list(overrides))


def frames_of(config: DictConfig) -> list[FrameId]:
    simulation = config.dataset.simulation
    return [
        FrameId(f"rig{rig}", f"drive{drive}", index)
        for rig in range(simulation.n_rigs)
        for drive in range(simulation.drives_per_rig)
        for index in range(simulation.frames_per_drive)
    ]


@pytest.mark.parametrize(
    ("name", "rigs", "drives", "by", "label"),
    [
        ("demo_one_rig", 1, 250, "drive", "simulated street-scene, one rig"),
        ("demo_drives", 60, 4, "rig", "simulated street-scene, 60 rigs"),
    ],
)
def test_only_rigs_and_drives_differ_from_the_demo(
    name: str, rigs: int, drives: int, by: str, label: str
) -> None:
    demo, dataset = composed().dataset, composed(f"dataset={name}").dataset
    settings = SimulationSettings.from_mapping(OmegaConf.to_container(dataset.simulation))  # type: ignore[arg-type]
    assert settings.n_frames == rigs * drives * 8
    assert (settings.n_rigs, settings.drives_per_rig) == (rigs, drives)
    assert dataset.root == dataset.recording.root == f"data/{name}"
    assert (dataset.name, dataset.split_by, dataset.label) == (name, by, label)
    same = set(demo) - {"name", "label", "root", "split_by", "simulation", "recording"}
    assert all(dataset[key] == demo[key] for key in same)
    counts = {"n_rigs", "drives_per_rig"}
    assert all(dataset.simulation[k] == demo.simulation[k] for k in set(demo.simulation) - counts)


@pytest.mark.parametrize("by", UNITS)
def test_splits_of_many_drives_train_on_as_many_and_test_on_the_same_rigs(by: str) -> None:
    config = composed(
        "dataset=demo_drives",
        f"split.by={by}",
        "split.block_frames=4",
        "split.unseen_rigs=0.2",
        "split.test=unseen",
        "split.train_frames=900",
    )
    split = instantiate(config.split).split(frames_of(config))
    # 48 of 60 rigs remain, 1536 frames: 15 % of them calibrate, give or take most of a rig.
    assert len(split.frames["train"]) == 900
    assert abs(len(split.frames["uncertainty_calibration"]) - 230) <= 32
    assert len(split.frames["test"]) == 12 * 4 * 8
    assert len({frame.rig for frame in split.frames["test"]}) == 12


def test_one_rig_with_many_drives_is_simulated_read_and_split(tmp_path: Path) -> None:
    drives = "dataset.simulation.drives_per_rig=30"
    root = f"dataset.root={tmp_path / 'one_rig'}"
    data = build_data(composed("dataset=demo_one_rig", drives, root, *TINY))
    # Drives begin an hour apart, so that the later ones begin on the next day.
    assert [len(data.splits[name]) for name in SPLITS] == [18, 5, 4, 3]
    assert {frame.rig for name in SPLITS for frame in data.splits[name]} == {"2041_01_01"}
    assert len({frame.drive for name in SPLITS for frame in data.splits[name]}) == 30
    last = data.recording.load(data.recording.frame_ids[-1])
    assert last.drive == "2041_01_01_drive_0030_sync"
    assert len(last.points) > 0
