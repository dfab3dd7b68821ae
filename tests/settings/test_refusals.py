"""A command line that Hydra refuses ends with one sentence of ours."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra._internal import utils as hydra_utils
from hydra.errors import CompactHydraException, ConfigCompositionException

from uncal.settings.command_line import quote_arguments
from uncal.settings.refusals import refusal, refused_options

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        ("train", ["dataset=kity"], "dataset=kity: no such option; did you mean kitti? there are"),
        ("train", ["logger=wandb"], "logger=wandb: no such option; there are tensorboard"),
        ("train", ["+sweeps=passess"], "+sweeps=passess: no such option; did you mean passes?"),
        ("train", ["hydra/launcher=slurm"], "no such option; there are basic, joblib"),
        ("train", ["-m", "model=unical,unicl"], "model=unicl: no such option; did you mean unical"),
        (
            "train",
            ["dataset.rot=k"],
            "dataset.rot: nothing reads this key; did you mean dataset.ro",
        ),
        ("train", ["datset=kitti"], "datset: nothing reads this key; did you mean dataset?"),
        ("train", ["batch_size=3"], "did you mean dataset.loader.batch_size?"),
        ("train", ["hydra.run.dr=x"], "hydra.run.dr: nothing reads this key; did you mean hydra.r"),
        ("train", ["model/backbon=edges"], "model/backbon: no such group; did you mean model/back"),
        ("train", ["split.qqqqqq=3"], "split.qqqqqq: nothing reads this key; split has _target_, "),
        ("train", ["mcd.passes.x=3"], "mcd.passes.x: nothing reads this key; --help lists"),
        ("train", ["mcd.passes=5,10"], "mcd.passes=5,10: several values; -m runs each in turn"),
        ("train", ["seed=range(1,3)"], "seed=range(1,3): several values; -m runs each in turn"),
        ("train", ["mcd.passes"], "mcd.passes: cannot be read as a setting; write key=value"),
        ("train", ["+mcd.passes=3"], "mcd.passes: the key is there already; write mcd.passes=…"),
        ("train", ["+dataset=kitti"], "dataset: one option is chosen already; write dataset=…"),
        ("train", ["~nothing"], "~nothing: there is no such key; leave it out"),
        ("train", ["~dataset"], "hydra.run.dir: Interpolation key 'dataset.name' not found"),
        ("train", ["dataset.root=${nothing}"], "dataset.root: Interpolation key 'nothing' not"),
        ("train", ["mcd.passes=${seed.x}"], "mcd.passes: "),
        ("train", ["-cn", "nowhere"], "nowhere: there is no such configuration"),
        ("train", ["-cd", "nowhere"], "nowhere' not found"),
        ("simulate", ["n_rigs=1"], "n_rigs: nothing reads this key; did you mean simulation.n_rig"),
        ("monitor", ["levl=0.9"], "levl: nothing reads this key; did you mean level?"),
        ("convert", ["topics.imag=/x"], "did you mean topics.image?"),
        ("export", ["fromat=onnx"], "fromat: nothing reads this key; did you mean format?"),
        ("export", ["weights=unical"], "out: must be given, as out=…"),
        ("convert", ["root=rig"], "source: must be given, as source=…"),
        ("calibrate", ["weights=unical"], "recordings: must be given, as recordings=…"),
        ("calibrate", ["interval=gausian"], "interval=gausian: no such option; did you mean gaus"),
    ],
)
def test_it_is_one_sentence(
    module: str, words: list[str], said: str, start: Run, tmp_path: Path
) -> None:
    ended = start(
        f"uncal.{module}{'.__main__' if module == 'monitor' else ''}", *words, cwd=tmp_path
    )
    assert ended.returncode == 1
    assert said in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert not list(tmp_path.rglob("results.csv"))


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("levels=[]", "levels=[]: expected a list"),
        ("levels=0.9", "levels=0.9: expected a list"),
        ("levels=[1.0]", "levels=[1.0]: expected a list"),
        ("image_size=232", "image_size=232: expected a list of 2, each a whole number from 32"),
    ],
)
def test_settings_of_an_export_have_bounds(
    word: str, said: str, start: Run, tmp_path: Path
) -> None:
    ended = start("uncal.export", "weights=unical", "out=a.onnx", word, cwd=tmp_path)
    assert ended.returncode == 1
    assert ended.stderr.startswith(said)
    assert not list(tmp_path.glob("*.onnx"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--epochs", "3"], "--epochs: no such option; settings are key=value without dashes"),
        (["-x"], "-x: no such option"),
        (["--cfg"], "argument --cfg/-c: expected one argument; --help shows how"),
        (["--cfg", "jobb"], "invalid choice: 'jobb'"),
        (["--resolve"], "--resolve: belongs to --cfg job"),
        (["--cfg", "job", "-m"], "give one of them"),
        (["seed", "=", "3"], "=: cannot be read as a setting; write key=value (key=…)"),
    ],
)
def test_dashes_are_told_from_settings(
    words: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["uncal.train", *words])
    with pytest.raises(SystemExit) as ended:
        quote_arguments()
    assert ended.value.code == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert len((shown.err + shown.out).splitlines()) == 1


def test_what_hydra_takes_passes() -> None:
    for words in (["--cfg", "job", "--resolve"], ["-m", "seed=0,1"], ["-cd", "x", "+a=1"], ["-h"]):
        assert refused_options(words) is None


def test_other_words_of_hydra_are_shown_without_its_folders() -> None:
    error = ConfigCompositionException("One thing.\nAnother.\nConfig search path:\n\tprovider=x")
    assert refusal(error) == "One thing. Another."


def test_what_is_said_before_a_job_starts_ends_the_process(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def report(error: BaseException) -> None:
        def fails() -> None:
            raise error

        hydra_utils.run_and_report(fails)

    with pytest.raises(SystemExit) as ended:
        report(CompactHydraException("a sentence"))
    assert ended.value.code == 1
    assert capsys.readouterr().err == "a sentence\n"
    with pytest.raises(SystemExit) as ended:
        report(KeyboardInterrupt())
    assert ended.value.code == 130
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(CompactHydraException):
        report(CompactHydraException("a sentence"))
