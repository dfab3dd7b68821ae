"""A multirun's summary, kept up to date from job to job; a callback of Hydra, not of Lightning."""

from __future__ import annotations

import logging
import multiprocessing
import pickle
import shlex
import sys
import time
import traceback
from pathlib import Path

from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import CompactHydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode, TaskFunction
from omegaconf import DictConfig

from uncal.multirun.folder import FIGURES, SUMMARY, Multirun
from uncal.multirun.plan import planned_jobs, share_cores
from uncal.multirun.summary import write_summary
from uncal.reporting.run import FAILED

log = logging.getLogger(__name__)

FIGURES_EVERY = 300.0
"""Seconds from one drawing to the next while jobs are still to come."""


class MultirunSummary(Callback):
    """Writes ``summary.csv``, ``summary.md`` and figures into the folder of a multirun.

    After every job and not only at the end: Hydra's sweeper raises what a failed job raised as soon
    as all jobs have run, and then calls ``on_multirun_end`` no more. A parallel launcher takes this
    object along into the processes of the jobs, which then write at the same time.

    Args:
        figures: whether to draw; takes seconds, every five minutes and after the last job.
    """

    def __init__(self, figures: bool = True) -> None:
        self.figures = figures
        # Taken here, because in the process of a job it would be the launcher's.
        self.command = shlex.join(["python", *sys.orig_argv[1:]])
        self.planned: list[dict[str, str]] | None = None

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Note what is to come."""
        self.planned = planned_jobs(config)
        share_cores(config, self.planned)

    def on_job_start(
        self, config: DictConfig, *, task_function: TaskFunction, **kwargs: object
    ) -> None:
        """List the job as unfinished, so that an interrupted multirun shows it."""
        if is_multirun(config):
            restore_start_method()
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
            make_portable(job_return, reason)
        multirun = self._write(config)
        settled = sum(1 for job in multirun.jobs if job.table is not None or job.failed)
        last = self.planned is not None and settled >= len(self.planned)
        if last or time.time() - _modified(multirun.captions) > FIGURES_EVERY:
            self._draw(multirun)

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Write all once more, when all launchers' jobs are done, and say where it is."""
        multirun = self._write(config)
        self._draw(multirun)
        log.info("summary of %d jobs: %s/summary.md", len(multirun.jobs), multirun.folder)

    def _write(self, config: DictConfig) -> Multirun:
        return write_summary(Path(config.hydra.sweep.dir), self.command, self.planned)

    def _draw(self, multirun: Multirun) -> None:
        """Figures; whatever goes wrong with them is no reason to lose a job or the summary."""
        frame, folder = multirun.frame, multirun.folder
        drawn = _modified(folder / SUMMARY) <= _modified(multirun.captions)
        if not self.figures or frame is None or drawn:
            return
        # Matplotlib takes a second to import, and most jobs do not draw.
        from uncal.multirun.figures import draw_figures, show_in_tensorboard

        try:
            show_in_tensorboard(draw_figures(folder, frame), folder / FIGURES)
        except Exception:
            log.exception("the figures of %s were not drawn", folder)
        write_summary(folder, self.command, self.planned)  # shows them


def restore_start_method() -> None:
    """Let a job start processes as anywhere else; does nothing outside joblib's processes.

    Joblib's library loky makes itself the way in which its processes start others. Those that load
    data or simulate then end at once: ``ValueError: cannot find context for 'loky'``.
    """
    if multiprocessing.get_start_method(allow_none=True) == "loky":
        multiprocessing.set_start_method(None, force=True)  # the default


def make_portable(job_return: JobReturn, reason: str) -> None:
    """Replace an error that cannot travel from the job's process to the launcher's.

    One such error would make the launcher give up on the jobs still to come.
    """
    try:
        pickle.loads(pickle.dumps(job_return._return_value))
    except Exception:
        job_return.return_value = CompactHydraException(reason)


def is_multirun(config: DictConfig) -> bool:
    """Whether a job belongs to a multirun."""
    return bool(config.hydra.mode == RunMode.MULTIRUN)


def failure(job_return: JobReturn) -> str:
    """Why a job failed: the message of an error that a user can act on, else the traceback's end.

    The whole traceback of the latter goes to the log; the error's local variables are let go.
    """
    try:
        _ = job_return.return_value  # raises what the job raised
    except Exception as error:
        if isinstance(error, CompactHydraException):
            reason = str(error)
        else:
            log.exception("unexpected error")
            reason = f"{type(error).__name__}: {error}"
        # Hydra keeps the error until the last job ends, and its frames hold data and network.
        chain: BaseException | None = error
        while chain is not None:
            traceback.clear_frames(chain.__traceback__)
            chain = chain.__cause__ or chain.__context__
        return reason
    return ""


def _modified(path: Path) -> float:
    """When a file was last written, by whichever process; long ago if it is not there."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
