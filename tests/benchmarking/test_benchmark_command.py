"""What a benchmark cannot work with is said before minutes are measured."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["ckpt=nowhere.ckpt"], "ckpt=nowhere.ckpt: no such file"),
        (["cases.xxs.model=[nonsense]"], "cases: model=['nonsense']: "),
        (['cases.xxs.model=["model=unicall"]'], "cases: model=['model=unicall']: "),
    ],
)
def test_it_is_a_sentence(words: list[str], said: str, start: Run, tmp_path: Path) -> None:
    done = start("uncal.benchmark", *words, cwd=tmp_path)
    assert done.returncode == 1
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("latency.csv"))
