"""A reader that leaves ends neither a run nor fills its log."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TextIO, cast

import pytest

from uncal.system.output import Outliving, outlive_readers


def test_what_nobody_reads_is_dropped() -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w", buffering=1) as stream:
        output = cast(TextIO, Outliving(stream))
        assert output.write("read\n") == 5
        assert os.read(reader, 10) == b"read\n"
        os.close(reader)
        for _ in range(3):
            assert output.write("dropped\n") == 8
            output.flush()
        assert not output.isatty()


def test_what_others_have_put_there_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123
        monkeypatch.setattr(sys, "stdout", nowhere)
        outlive_readers()
        assert sys.stdout is nowhere


def test_a_run_goes_on_without_its_reader(tmp_path: Path) -> None:
    code = """
import logging, sys
from uncal.settings.configuration import exits_on_error
@exits_on_error
def main():
    logging.basicConfig(stream=sys.stdout, level="INFO")
    for number in range(20_000):
        logging.info("line %d", number)
    sys.stderr.write("finished\\n")
main()
"""
    command = f"{sys.executable} -c '{code}' | head -1; exit ${{PIPESTATUS[0]}}"
    ended = subprocess.run(
        ["bash", "-c", command],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0
    assert ended.stdout == "INFO:root:line 0\n"
    assert ended.stderr == "finished\n"
