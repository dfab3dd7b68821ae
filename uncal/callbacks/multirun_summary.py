"""A multirun's summary, kept up to date from job to job; a callback of Hydra, not of Lightning."""

from __future__ import annotations

import logging
import shlex
import sys
import traceback
from pathlib import Path

from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import CompactHydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode, TaskFunction
from omegaconf import DictConfig

from uncal.reporting.multirun import write_summary
from uncal.reporting.multirun_jobs import FAILED

log = logging.getLogger(__name__)


class MultirunSummary(Callback):
    """Writes ``summary.csv`` and ``summary.md`` into the folder of a multirun.

    After every job and not only at the end: Hydra's sweeper raises what a failed job raised as soon
    as all jobs have run, and then calls ``on_multirun_end`` no more.
    """

    def __init__(self) -> None:
        # Taken here, because a launcher may pickle the callback into other processes.
        self.command = shlex.join(["python", *sys.orig_argv[1:]])

    def on_job_start(
        self, config: DictConfig, *, task_function: TaskFunction, **kwargs: object
    ) -> None:
        """List the job as unfinished, so that an interrupted multirun shows it."""
        if is_multirun(config):
            (Path(config.hydra.runtime.output_dir) / FAILED).unlink(missing_ok=True)
            self._write(config)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: object) -> None:
        """Take the job in; keep the reason if it failed."""
        if not is_multirun(config):
            return
        if job_return.status is JobStatus.FAILED:
            folder = Path(config.hydra.runtime.output_dir)
            reason = failure(job_return)
            (folder / FAILED).write_text(f"{reason}\n", encoding="utf-8")
            names_it = f"{config.hydra.sweep.dir}/summary.md names it, the other jobs run on"
            log.error("%s\nThis job failed; %s.", reason, names_it)
        self._write(config)

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Write the summary once more, when all launchers' jobs are done, and say where it is."""
        jobs = self._write(config)
        log.info("summary of %d jobs: %s/summary.md", jobs, config.hydra.sweep.dir)

    def _write(self, config: DictConfig) -> int:
        return len(write_summary(Path(config.hydra.sweep.dir), self.command))


def is_multirun(config: DictConfig) -> bool:
    """Whether a job belongs to a multirun.

    Args:
        config: the job's, with Hydra's own node.
    """
    return bool(config.hydra.mode == RunMode.MULTIRUN)


def failure(job_return: JobReturn) -> str:
    """Why a job failed; its local variables are let go.

    Args:
        job_return: of a failed job.

    Returns:
        The message of an error that a user can act on, else the traceback's last line; the whole
        traceback of such an error goes to the log.
    """
    try:
        _ = job_return.return_value  # raises what the job raised
    except Exception as error:
        if isinstance(error, CompactHydraException):
            reason = str(error)
        else:
            log.exception("unexpected error")
            reason = f"{type(error).__name__}: {error}"
        _let_go(error)
        return reason
    return ""


def _let_go(error: BaseException) -> None:
    """Hydra keeps the error until the last job ends, and its frames hold data and network."""
    chain: BaseException | None = error
    while chain is not None:
        traceback.clear_frames(chain.__traceback__)
        chain = chain.__cause__ or chain.__context__
