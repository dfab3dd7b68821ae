"""``run.json``: what a run was, so that its results can be placed and it need not run again."""

from __future__ import annotations

import json
import shlex
import subprocess
import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path

from uncal import __version__
from uncal.reporting.frames import TABLES
from uncal.reporting.layout import read_json, write_whole

NAME = "run.json"


class RunRecord:
    """Begins with a run and is written when its results are.

    Args:
        folder: of the run.
        request: digest of everything that decides the results.
        about: what the run is, as plain values: ``command`` (starts this run, and no other of its
            multirun), ``label`` of the data, ``seed``, ``device``, and the ``settings`` that
            another process needs to repeat it.
    """

    def __init__(self, folder: Path, request: str, **about: object) -> None:
        self.path = folder / NAME
        self.request = request
        self._began = time.monotonic()
        own = {"commit": commit_of_code(), "version": __version__, "request": request}
        self._content = {**own, **about}

    def begin(self) -> None:
        """Take away what an earlier run of other settings left in the folder.

        Its tables would pass for this run's until this one ends, or for good if it does not.
        """
        for name in (NAME, "results.md", *(schema.file for schema in TABLES)):
            (self.path.parent / name).unlink(missing_ok=True)

    def finished_earlier(self) -> Mapping[str, object] | None:
        """The record of a finished run of the same request in the same folder; None without."""
        found = read_record(self.path.parent)
        if found is None or found.get("request") != self.request:
            return None
        return found if (self.path.parent / "results.csv").is_file() else None

    def write(self, **results: object) -> Path:
        """Write what the run was and what came out."""
        content = {
            **self._content,
            "finished": datetime.now().isoformat(timespec="seconds"),
            "seconds": round(time.monotonic() - self._began, 1),
            **results,
        }
        return write_whole(self.path, f"{json.dumps(content, indent=1, ensure_ascii=False)}\n")


def read_record(folder: Path) -> dict[str, object] | None:
    """The record in a run's folder; None, with a warning if it is damaged, where there is none."""
    return read_json(folder / NAME, "taken for missing")


def command_line(module: str, overrides: Sequence[str]) -> str:
    """The command that starts one run.

    >>> command_line("uncal.train", ["seed=1", "interval.levels=[0.5, 0.9]"])
    "python -m uncal.train seed=1 'interval.levels=[0.5, 0.9]'"
    """
    return shlex.join(["python", "-m", module, *overrides])


def commit_of_code() -> str | None:
    """Short hash of this code's commit, "+" if changed since; None outside a git repository."""
    package = Path(__file__).resolve().parents[1]
    if not (package.parent / ".git").exists():
        return None
    git = ["git", "-C", str(package.parent)]
    ask = partial(subprocess.run, capture_output=True, text=True, timeout=10, check=True)
    try:
        head = ask([*git, "rev-parse", "--short", "HEAD"]).stdout.strip()
        changed = ask([*git, "status", "--porcelain", "--", "uncal", "conf"]).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{head}+" if changed else head
