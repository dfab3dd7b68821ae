"""Paths are taken as the shell gives them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from uncal.settings.command_line import quote_arguments, quoted, readable


@pytest.mark.parametrize(
    "path",
    ["out/a=1 b/best.ckpt", "out/lr=0.1,x=2/best.ckpt", "out/é (1)/a=b.ckpt", 'out/"a"=1.ckpt'],
)
def test_a_path_reaches_hydra_as_it_is(path: str) -> None:
    (word,) = quoted([f"ckpt={path}"])
    assert OverridesParser.create().parse_override(word).value() == path


@pytest.mark.parametrize(
    "word",
    [
        *("seed=1", "mcd.passes=5,10", "~logger", "+a.b=[1,2]", "dataset.drives=['2011/*']"),
        *("ckpt='out/a=1.ckpt'", "--cfg", "-cd=x", "interval.levels=", "a={b: 1}"),
    ],
)
def test_what_hydra_reads_or_nobody_does_is_left_alone(word: str) -> None:
    assert quoted([word]) == [word]


def test_no_group_is_said_as_no_key_is(tmp_path: Path) -> None:
    (tmp_path / "model" / "head").mkdir(parents=True)
    words = ["model=null", "model/head=null", "model.head=null", "logger=null", "+model=x"]
    assert readable(words, tmp_path) == ["~model", "~model/head", *words[2:]]


def test_a_multirun_is_asked_for_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["train.py", "seed=0", "-m", "mcd.passes=5,10"])
    quote_arguments()
    assert sys.argv == ["train.py", "-m", "seed=0", "mcd.passes=5,10"]


def test_the_processes_own_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["a=b=c.py", "ckpt=a=1.ckpt", "logger=null"])
    quote_arguments()
    assert sys.argv == ["a=b=c.py", 'ckpt="a=1.ckpt"', "~logger"]
