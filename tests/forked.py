"""Entry points in processes of their own, forked from one that has imported what they need."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path

IMPORTED = (
    "uncal.runs.assembly",
    "uncal.runs.checkpoint",
    "uncal.runs.weights_to_report",
    "uncal.simulation.writer",
    "lightning.pytorch.callbacks",
    "lightning.pytorch.loggers",
    "torch._dynamo",
    "torch.utils.tensorboard",
    "transformers.models.mobilevit.modeling_mobilevit",
)
"""What takes a run seconds to import; imported once, when the first process is asked for."""


@cache
def _server() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(IMPORTED))
    return context


class Forked:
    """``python -m module words``, without its imports; signals reach it as they do any process."""

    def __init__(self, module: str, *words: str, cwd: Path, environment: Mapping[str, str]) -> None:
        self.command = [sys.executable, "-m", module, *words]
        self._output = [tempfile.NamedTemporaryFile() for _ in range(2)]  # noqa: SIM115
        names = [file.name for file in self._output]
        arguments = (module, words, str(cwd), dict(environment), names)
        self._process = _server().Process(target=_run, args=arguments)
        self._process.start()

    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._process.is_alive()

    def send_signal(self, number: int) -> None:
        """To this process alone."""
        if self._process.pid is not None and self.is_running():
            os.kill(self._process.pid, number)

    def finished(self, timeout: float) -> subprocess.CompletedProcess[str]:
        """Wait for its end; killed, with an error, if that takes longer than so many seconds."""
        self._process.join(timeout)
        if self.is_running():
            self._process.kill()
            raise subprocess.TimeoutExpired(self.command, timeout)
        stdout, stderr = (file.read().decode() for file in self._output)
        code = self._process.exitcode
        assert code is not None
        return subprocess.CompletedProcess(self.command, code, stdout, stderr)


def _run(
    module: str, words: tuple[str, ...], cwd: str, environment: dict[str, str], output: list[str]
) -> None:
    for descriptor, path in enumerate(output, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_APPEND), descriptor)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    multiprocessing.set_start_method(None, force=True)  # as if nothing had been forked
    sys.path.insert(0, cwd)
    sys.argv = [module, *words]
    sys.orig_argv = ["python", "-m", *sys.argv]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
