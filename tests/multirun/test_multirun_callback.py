"""Multiruns of a task that does next to nothing, by Hydra's own sweeper and launcher."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import hydra
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.utils import instantiate
from omegaconf import DictConfig

from uncal.errors import ConfigurationError, UncalError
from uncal.geometry import DOF_NAMES
from uncal.multirun.callback import MultirunSummary, failure
from uncal.reporting.frames import RESULTS, write_csv
from uncal.settings.configuration import CONFIG_DIR, exits_on_error


class CannotTravelError(Exception):
    """Its constructor takes two arguments, but pickle gives it the one message."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="train")
@exits_on_error
def task(config: DictConfig) -> float:
    passes = config.mcd.passes
    if passes == 1:
        raise ConfigurationError("one pass gives no spread; set at least 2")
    if passes == 2:
        raise ZeroDivisionError("an error of the program")
    if passes == 9:
        raise CannotTravelError("a", "b")
    if passes == 3:  # as uncal.train passes Ctrl-C on
        raise UncalError("interrupted; go on with ckpt=…") from SystemExit(1)
    rows = [[name, "cm", 90.0, *[float(passes)] * 5, True, *[1.0] * 3, 1, 1] for name in DOF_NAMES]
    folder = Path(HydraConfig.get().runtime.output_dir)
    write_csv(folder / "results.csv", pd.DataFrame(rows, columns=list(RESULTS.columns)))
    (folder / "run.json").write_text('{"label": "made-up"}', encoding="utf-8")
    return float(passes)


def start(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.chdir(folder)
    quiet = ["hydra/hydra_logging=disabled", "hydra/job_logging=disabled"]
    if not any("figures" in argument for argument in arguments):
        quiet.append("++hydra.callbacks.summary.figures=false")  # they take seconds
    where = ["hydra.sweep.dir=many", "hydra.run.dir=one"]
    command = ["task", *arguments, *quiet, *where]
    monkeypatch.setattr(sys, "argv", command)
    monkeypatch.setattr(sys, "orig_argv", ["/usr/bin/python3", "-m", *command])
    task()


def jobs_with_results(folder: Path) -> list[str]:
    with (folder / "many" / "summary.csv").open(encoding="utf-8") as file:
        return list(dict.fromkeys(row["mcd.passes"] for row in csv.DictReader(file)))


def markdown(folder: Path) -> str:
    return (folder / "many" / "summary.md").read_text(encoding="utf-8")


def test_a_multirun_is_summarised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start(tmp_path, monkeypatch, "-m", "mcd.passes=5,7")
    assert jobs_with_results(tmp_path) == ["5", "7"]
    text = markdown(tmp_path)
    assert text.startswith("# Multirun on made-up data")
    assert "    python -m task -m mcd.passes=5,7 " in text
    assert "Jobs: 2, with results: 2" in text
    assert "without results" not in text


def test_the_others_run_on_after_a_failed_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        start(tmp_path, monkeypatch, "-m", "mcd.passes=1,2,7")
    assert ended.value.code == 1
    assert jobs_with_results(tmp_path) == ["7"]
    text = markdown(tmp_path)
    assert "Jobs: 3, with results: 1" in text
    assert "- `0` (mcd.passes=1): one pass gives no spread; set at least 2" in text
    assert "- `1` (mcd.passes=2): ZeroDivisionError: an error of the program" in text
    shown = capsys.readouterr().err
    assert "one pass gives no spread" in shown
    assert "Traceback" not in shown


def test_a_second_attempt_in_the_same_folder_forgets_the_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit):
        start(tmp_path, monkeypatch, "-m", "mcd.passes=1")
    assert "Jobs: 1, with results: 0" in markdown(tmp_path)
    start(tmp_path, monkeypatch, "-m", "mcd.passes=5")
    assert "Jobs: 1, with results: 1" in markdown(tmp_path)
    assert "without results" not in markdown(tmp_path)


def test_ctrl_c_ends_the_multirun_and_keeps_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit, match="interrupted; go on"):
        start(tmp_path, monkeypatch, "-m", "mcd.passes=5,3,7")
    assert jobs_with_results(tmp_path) == ["5"]
    text = markdown(tmp_path)
    assert "- `1` (mcd.passes=3): no results.csv: still running, interrupted" in text
    assert "- not started (mcd.passes=7)" in text
    assert "    python -m task -m mcd.passes=5,3,7 " in text
    assert not (tmp_path / "many" / "2").exists()


def test_a_single_run_has_no_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start(tmp_path, monkeypatch, "mcd.passes=5")
    assert (tmp_path / "one" / "results.csv").is_file()
    assert not list(tmp_path.rglob("summary.*"))
    with pytest.raises(SystemExit, match="one pass gives no spread"):
        start(tmp_path, monkeypatch, "mcd.passes=1")
    assert not list(tmp_path.rglob("failed.txt"))


@pytest.mark.parametrize("entry_point", ["train", "evaluate"])
def test_the_configuration_names_it(entry_point: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose(entry_point, return_hydra_config=True)
    callbacks = [instantiate(each) for each in config.hydra.callbacks.values()]
    assert [type(each) for each in callbacks] == [MultirunSummary]


def test_a_failure_lets_go_of_what_its_frames_held() -> None:
    def fail() -> None:
        held = bytearray(8)
        raise ValueError(f"{len(held)} bytes")

    failed = JobReturn(overrides=[], status=JobStatus.FAILED)
    try:
        fail()
    except ValueError as error:
        failed.return_value = error
    assert failure(failed) == "ValueError: 8 bytes"
    with pytest.raises(ValueError, match="8 bytes") as raised:
        _ = failed.return_value
    frames = [entry.frame.f_locals for entry in raised.traceback if entry.name == "fail"]
    assert frames == [{}]


def test_figures_are_drawn_after_the_last_job_even_if_one_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[str] = []

    def draw(folder: Path, frame: pd.DataFrame) -> list[Path]:
        drawn.append(",".join(frame["folder"].unique()))
        return captioned(folder)

    monkeypatch.setattr("uncal.multirun.figures.draw_figures", draw)
    figures = "++hydra.callbacks.summary.figures=true"
    with pytest.raises(SystemExit):
        start(tmp_path, monkeypatch, "-m", "mcd.passes=5,7,8,1", figures)
    assert drawn == ["0", "0,1,2"]  # at once, then not for minutes, then at the end
    assert "![Coverage](figures/coverage.png)" in markdown(tmp_path)

    start(tmp_path, monkeypatch, "-m", "mcd.passes=5,7,8,6", figures)
    assert drawn[2:] == ["0,1,2,3"]  # once: on_multirun_end finds them up to date


def captioned(folder: Path) -> list[Path]:
    (folder / "figures").mkdir(exist_ok=True)
    listed = folder / "figures" / "captions.csv"
    listed.write_text("name,title,caption\ncoverage,Coverage,How to read it.\n")
    return [listed]


def test_a_figure_that_cannot_be_drawn_breaks_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []

    def draw(folder: Path, frame: pd.DataFrame) -> list[Path]:
        raise ZeroDivisionError("no such font")

    monkeypatch.setattr("uncal.multirun.callback.log.exception", lambda text, *_: said.append(text))
    monkeypatch.setattr("uncal.multirun.figures.draw_figures", draw)
    start(tmp_path, monkeypatch, "-m", "mcd.passes=5,7", "++hydra.callbacks.summary.figures=true")
    assert jobs_with_results(tmp_path) == ["5", "7"]
    assert "Jobs: 2, with results: 2" in markdown(tmp_path)
    assert "were not drawn" in said[-1]


def test_leftovers_of_a_larger_multirun_are_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start(tmp_path, monkeypatch, "-m", "mcd.passes=5,6,7")
    start(tmp_path, monkeypatch, "-m", "mcd.passes=5")
    text = markdown(tmp_path)
    assert "Left out: 2 folders of an earlier multirun (`1`, `2`)." in text
    assert "Jobs: 1, with results: 1" in text


@pytest.mark.slow
def test_parallel_jobs_are_summarised_and_the_others_run_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joblib = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    with pytest.raises(SystemExit) as ended:
        start(tmp_path, monkeypatch, "-m", "mcd.passes=9,5,2,6,7", *joblib)
    assert ended.value.code == 1
    assert jobs_with_results(tmp_path) == ["5", "6", "7"]
    text = markdown(tmp_path)
    assert "    python -m task -m mcd.passes=9,5,2,6,7 hydra/launcher=joblib" in text
    assert "- `0` (mcd.passes=9): CannotTravelError: a and b" in text
    assert "- `2` (mcd.passes=2): ZeroDivisionError: an error of the program" in text
    assert not list((tmp_path / "many").glob(".*partial"))
