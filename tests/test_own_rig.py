"""The session of docs/own-rig.md, from bag to verdict, in small."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., "subprocess.CompletedProcess[str]"]

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "own-rig.md"
SMALLER = {"simulation.frames_per_drive=8": "simulation.frames_per_drive=4"}
FASTER = {"uncal.calibrate": ["mcd.passes=4", "references=false"]}


def commands() -> list[list[str]]:
    """Words of each command of the session."""
    session = PAGE.read_text(encoding="utf-8").split("## One session")[1]
    block = re.findall(r"```console\n(.*?)```", session, re.DOTALL)[0].replace("\\\n", " ")
    return [shlex.split(line[2:]) for line in block.splitlines() if line.startswith("$ ")]


def test_the_session_goes_all_the_way() -> None:
    modules = [words[2] for words in commands()]
    order = [f"uncal.{n}" for n in ("convert", "check", "calibrate", "monitor", "export")]
    assert [modules.index(name) for name in order] == sorted(map(modules.index, order))


@pytest.mark.slow
def test_every_command_of_the_session_runs(tmp_path: Path, start: Run, start_forked: Run) -> None:
    pytest.importorskip("onnxscript")
    said = {}
    for words in commands():
        assert words[:2] == ["python", "-m"]
        asked = [SMALLER.get(word, word) for word in words[3:]] + FASTER.get(words[2], [])
        # Only as a program of its own does this one choose the dataset.
        ask = start_forked if words[2] == "uncal.calibrate" else start
        module = f"{words[2]}.__main__" if words[2] == "uncal.monitor" else words[2]
        done = ask(module, *asked, cwd=tmp_path)
        assert done.returncode == 0, (words, done.stdout[-2000:], done.stderr[-2000:])
        said[words[2]] = done.stdout
    assert "pairs: 4" in said["uncal.convert"]
    assert (
        "interval=conformal: it holds for frames of drives like these 3" in said["uncal.calibrate"]
    )
    assert "4 frames:" in said["uncal.monitor"]
    for name in ("my_rig.safetensors", "my_rig.transform.yaml", "my_rig.urdf", "my_rig.onnx"):
        assert (tmp_path / name).is_file(), name
