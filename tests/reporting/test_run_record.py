import json
from pathlib import Path

import pytest

from uncal.reporting.run_record import RunRecord, command_line, read_record


def record(folder: Path, request: str = "abc") -> RunRecord:
    return RunRecord(
        folder,
        request,
        command=command_line("uncal.train", ["mcd.passes=5"]),
        settings={"seed": 3, "mcd": {"passes": 5}},
        label="simulated street-scene",
        seed=3,
        device="cpu",
    )


def test_a_record_says_what_the_run_was_and_what_came_out(tmp_path: Path) -> None:
    record(tmp_path).write(mean_ratio=0.5, weights={"reused": True})
    content = read_record(tmp_path)
    assert content is not None
    assert content["command"] == "python -m uncal.train mcd.passes=5"
    assert content["label"] == "simulated street-scene"
    assert content["settings"] == {"seed": 3, "mcd": {"passes": 5}}
    assert content["weights"] == {"reused": True}
    assert content["mean_ratio"] == 0.5
    assert {"finished", "seconds", "commit", "version", "device", "seed"} <= set(content)


def test_a_run_that_asked_the_same_and_ended_is_known(tmp_path: Path) -> None:
    first = record(tmp_path)
    assert first.finished_earlier() is None
    first.write(mean_ratio=0.5)
    assert first.finished_earlier() is None  # without its table it has not ended
    (tmp_path / "results.csv").write_text("dof\n")
    found = record(tmp_path).finished_earlier()
    assert found is not None
    assert found["mean_ratio"] == 0.5
    assert record(tmp_path, request="other").finished_earlier() is None


def test_a_run_that_begins_again_is_not_finished(tmp_path: Path) -> None:
    first = record(tmp_path)
    first.write(mean_ratio=0.5)
    (tmp_path / "results.csv").write_text("dof\n")
    again = record(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    again.begin()
    assert record(tmp_path).finished_earlier() is None
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("damage", ["", "{", "[]"])
def test_a_damaged_record_is_taken_for_missing(tmp_path: Path, damage: str) -> None:
    (tmp_path / "run.json").write_text(damage)
    (tmp_path / "results.csv").write_text("dof\n")
    assert read_record(tmp_path) is None
    assert record(tmp_path).finished_earlier() is None


def test_numbers_survive(tmp_path: Path) -> None:
    record(tmp_path).write(mean_ratio=0.1 + 0.2)
    content = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert content["mean_ratio"] == 0.1 + 0.2
