"""A bar on a terminal; in a log a line now and then, and no carriage returns."""

from __future__ import annotations

import io
import re
import sys

import pytest

from uncal.system import progress
from uncal.system.progress import progress_bar, watched


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    """Time that passes only when told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("tqdm.std.time", clock)
    return clock


def test_a_log_gets_a_line_every_ten_seconds(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    bar = progress_bar("training", 1000)
    for _ in range(1000):
        clock.now += 0.1
        bar.set_postfix({"epoch": "1/2"}, refresh=False)
        bar.update()
    bar.close()
    lines = log.getvalue().splitlines()
    assert "\r" not in log.getvalue()
    assert 9 <= len(lines) <= 12
    assert all(line.startswith("training: ") for line in lines)
    assert re.match(r"training: 1000/1000 \[01:(39|40)<00:00", lines[-1])
    assert lines[-1].endswith("epoch=1/2]")


def test_what_is_over_at_once_says_nothing_unless_it_stays(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    assert list(watched([1, 2, 3], "MC dropout, validation")) == [1, 2, 3]
    assert log.getvalue() == ""
    bar = progress_bar("training", 3)
    bar.update(3)
    bar.close()
    bar.close()
    assert log.getvalue().count("\n") == 1
    assert log.getvalue().startswith("training: 3/3")


def test_an_iteration_that_takes_long_is_shown(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    for _ in watched(range(50), "image-blind, test"):
        clock.now += 1.0
    lines = log.getvalue().splitlines()
    assert 4 <= len(lines) <= 6
    assert "\r" not in log.getvalue()


def test_quiet_is_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream in (io.StringIO(), Terminal()):
        monkeypatch.setattr(sys, "stderr", stream)
        assert list(watched(range(3), "x", quiet=True)) == [0, 1, 2]
        progress_bar("y", 3, quiet=True).close()
        assert stream.getvalue() == ""


def test_a_terminal_keeps_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    bar = progress_bar("training", 4, done=1)
    bar.update(3)
    bar.close()
    assert "\r" in terminal.getvalue()
    assert "training: 100%" in terminal.getvalue()
    assert progress.LOG_INTERVAL >= 2.0
