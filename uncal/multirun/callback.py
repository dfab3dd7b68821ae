"""A multirun's plan, and its summary, kept up to date from job to job: a callback of Hydra."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import shlex
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import CompactHydraException, HydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf

from uncal.multirun.folder import FIGURES, SUMMARY, Multirun, as_mapping
from uncal.multirun.summary import write_summary
from uncal.reporting.run import FAILED

log = logging.getLogger(__name__)

FIGURES_EVERY = 300.0
"""Seconds from one drawing to the next while jobs are still to come."""

THREADS = "OMP_NUM_THREADS"


class MultirunSummary(Callback):
    """Writes ``summary.csv``, ``summary.md`` and figures into the folder of a multirun.

    After every job and not only at the end: Hydra's sweeper raises what a failed job raised as soon
    as all jobs have run, and then calls ``on_multirun_end`` no more. A parallel launcher takes this
    object along into the processes of the jobs, which then write at the same time. Figures are
    drawn, if wanted, in seconds, every five minutes and after the last job.
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
        if config.hydra.mode == RunMode.MULTIRUN:
            restore_start_method()
            (Path(config.hydra.runtime.output_dir) / FAILED).unlink(missing_ok=True)
            self._write(config)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: object) -> None:
        """Take the job in; keep the reason if it failed."""
        if config.hydra.mode != RunMode.MULTIRUN:
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


def planned_jobs(config: DictConfig) -> list[dict[str, str]] | None:
    """The overrides of every job in order, key → value; None if only the sweeper knows them.

    It does where it looks at results before it goes on, or will refuse the command line.
    """
    sweeper = config.hydra.sweeper
    if not str(sweeper._target_).endswith(f".{BasicSweeper.__name__}"):
        return None
    swept = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
    given = OmegaConf.to_container(config.hydra.overrides.task, resolve=False)
    try:
        parsed = OverridesParser.create().parse_overrides([*swept, *cast("list[str]", given)])
        (jobs,) = BasicSweeper.split_arguments(parsed, None)
    except (HydraException, AssertionError):  # glob() asserts what only the sweeper has
        return None
    return [as_mapping(job) for job in jobs]


def share_cores(config: DictConfig, planned: Sequence[Mapping[str, str]] | None) -> None:
    """Let parallel jobs on one machine share its cores, unless ``OMP_NUM_THREADS`` is set.

    The variable is set in this process, whose jobs' processes inherit it before they import torch;
    otherwise each would start a thread per core, and together they would be slower than in turn.
    """
    from joblib import cpu_count  # type: ignore[import-untyped]

    known = None if planned is None else len(planned)
    threads = threads_per_job(config.hydra.launcher, known, cpu_count())
    if threads is not None and THREADS not in os.environ:
        os.environ[THREADS] = str(threads)
        log.info("%d thread(s) per job; set %s for another number", threads, THREADS)


def threads_per_job(
    launcher: Mapping[str, Any] | DictConfig, planned: int | None, cores: int
) -> int | None:
    """Threads for every job of a parallel launcher; None to leave it to the job's process.

    >>> threads_per_job({"_target_": "plugin.JoblibLauncher", "n_jobs": 2}, planned=8, cores=16)
    8
    >>> threads_per_job({"_target_": "plugin.LocalLauncher"}, planned=8, cores=16)
    2
    """
    name, n_jobs = str(launcher["_target_"]).rpartition(".")[2], launcher.get("n_jobs")
    if (asked := launcher.get("cpus_per_task")) is not None:
        return int(asked)
    if name == "JoblibLauncher" and n_jobs:
        at_once = n_jobs if n_jobs > 0 else max(1, cores + 1 + n_jobs)
    elif name == "LocalLauncher":  # submitit starts all jobs at the same time
        at_once = planned or 1
    else:
        return None
    return int(max(1, cores // min(at_once, planned or at_once)))
