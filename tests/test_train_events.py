"""Whole runs on events, as a user starts them."""

import csv
import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from uncal.geometry import DOF_NAMES

Run = Callable[..., "subprocess.CompletedProcess[str]"]

SIMULATION = [
    "n_rigs=10",
    "frames_per_drive=4",
    "events.subframes=3",
    "lidar.azimuth_step_deg=0.4",
]
TRAINED = ["dataset.loader.batch_size=4", "trainer.max_epochs=1", "trainer.accelerator=cpu"]
TRAINED += ["mcd.passes=4", "callbacks.figures=null"]


def finished(process: subprocess.CompletedProcess[str]) -> str:
    assert process.returncode == 0, process.stderr[-4000:]
    return process.stdout


def refused(process: subprocess.CompletedProcess[str]) -> str:
    assert process.returncode == 1
    assert "Traceback" not in process.stderr
    assert "full_key" not in process.stderr
    return process.stderr


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("event_runs")


@pytest.fixture(scope="module")
def demo(workplace: Path, start: Run) -> str:
    """One tiny run of the event demo; the tests below look at what it left."""
    settings = [f"dataset.simulation.{setting}" for setting in SIMULATION]
    command = ["dataset=demo_events", *settings, *TRAINED, "hydra.run.dir=first"]
    command += ["callbacks.overlays.frames=2", "callbacks.interval_overlays.frames=2"]
    return finished(start("uncal.train", *command, cwd=workplace))


def test_the_demo_ends_in_the_papers_table(demo: str, workplace: Path) -> None:
    table = rows(workplace / "first" / "results.csv")
    assert [(row["dof"], float(row["level"])) for row in table] == [
        (dof, level) for level in (90.0, 95.0, 99.0) for dof in DOF_NAMES
    ]
    assert all(math.isfinite(float(row["mae_after"])) for row in table)
    assert "simulated event-camera" in demo
    assert "Split by rig" in demo
    # Every frame of the simulation has enough events.
    assert not (workplace / "first" / "skipped.csv").exists()


def test_overlays_show_events_of_both_signs(demo: str, workplace: Path) -> None:
    pictures = list((workplace / "first" / "overlays").glob("*.png"))
    assert pictures
    for path in pictures:
        read = cv2.imread(str(path))
        assert read is not None
        picture = read[:, :, ::-1].astype(int)
        white = (picture == 255).all(-1).mean()
        assert 0.2 < white < 0.95
        pale = picture.min(-1) > 90  # events, not points
        assert (pale & (picture[..., 2] - picture[..., 0] > 40)).any()
        assert (pale & (picture[..., 0] - picture[..., 2] > 40)).any()


def test_the_checkpoint_can_be_asked_again(demo: str, workplace: Path, start: Run) -> None:
    command = ["ckpt=first/checkpoints/best.ckpt", "hydra.run.dir=again"]
    finished(start("uncal.evaluate", *command, cwd=workplace))
    first, again = (workplace / name / "results.csv" for name in ("first", "again"))
    assert first.read_bytes() == again.read_bytes()


def test_a_stand_in_for_dsec_runs_from_simulation_to_table(workplace: Path, start: Run) -> None:
    settings = [f"simulation.{setting}" for setting in SIMULATION]
    simulate = ["simulation=event_street", "root=standin", "simulation.drives_per_rig=2", *settings]
    finished(start("uncal.simulate", *simulate, "simulation.n_rigs=4", cwd=workplace))
    command = [
        "dataset=dsec",
        "dataset.root=standin",
        "dataset.image_size=[80,208]",
        "model/inputs/events=time_surface",
        "model/backbone=mobilevit_xxs",
        "model/head=mlp",
        "callbacks.overlays=null",
        "callbacks.interval_overlays=null",
        "hydra.run.dir=dsec",
    ]
    output = finished(start("uncal.train", *command, *TRAINED, cwd=workplace))
    assert {row["n_test"] for row in rows(workplace / "dsec" / "results.csv")} == {"8"}
    markdown = (workplace / "dsec" / "results.md").read_text(encoding="utf-8")
    for text in (" ".join(output.split()), markdown):
        assert "Split by official" in text
        assert "No official test sequence with LiDAR" in text
        assert "simulated (a stand-in for DSEC)" in text


def test_without_data_it_says_where_to_get_them_or_a_stand_in(workplace: Path, start: Run) -> None:
    message = refused(start("uncal.train", "dataset=dsec", cwd=workplace))
    assert "data/dsec does not exist" in message
    assert "https://dsec.ifi.uzh.ch" in message
    assert "\n  python -m uncal.simulate simulation=event_street root=" in message


@pytest.mark.parametrize(
    ("choices", "remedy"),
    [
        (["dataset=demo_events", "model=unical"], "choose model=muliev"),
        (["model=muliev"], "choose model=unical"),
    ],
)
def test_a_model_that_cannot_read_the_data_is_one_sentence(
    workplace: Path, start: Run, choices: list[str], remedy: str
) -> None:
    message = refused(start("uncal.train", *choices, "dataset.root=unmade", cwd=workplace))
    assert len(message.strip().splitlines()) == 1
    assert remedy in message
    assert not (workplace / "unmade").exists()
