"""What a multirun is going to do: its jobs, and the threads that each of them may use."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig

from uncal.multirun.jobs import as_mapping

log = logging.getLogger(__name__)

THREADS = "OMP_NUM_THREADS"


def planned_jobs(config: DictConfig) -> list[dict[str, str]] | None:
    """The overrides of every job, key → value.

    Returns:
        The jobs in order; None if only the sweeper knows them: one that looks at results before
        it goes on, or a command line that it will refuse.
    """
    sweeper = config.hydra.sweeper
    if not str(sweeper._target_).endswith(f".{BasicSweeper.__name__}"):
        return None
    swept = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
    try:
        parsed = OverridesParser.create().parse_overrides([*swept, *config.hydra.overrides.task])
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

    launcher = config.hydra.launcher
    threads = threads_per_job(
        str(launcher._target_).rpartition(".")[2],
        n_jobs=launcher.get("n_jobs"),
        cpus_per_task=launcher.get("cpus_per_task"),
        planned=None if planned is None else len(planned),
        cores=cpu_count(),
    )
    if threads is not None and THREADS not in os.environ:
        os.environ[THREADS] = str(threads)
        log.info("%d thread(s) per job; set %s for another number", threads, THREADS)


def threads_per_job(
    launcher: str,
    *,
    n_jobs: int | None,
    cpus_per_task: int | None,
    planned: int | None,
    cores: int,
) -> int | None:
    """Threads for every job of a parallel launcher.

    Returns:
        None to leave it to the job's process: one job at a time, or on a machine of its own.

    >>> threads_per_job("JoblibLauncher", n_jobs=2, cpus_per_task=None, planned=8, cores=16)
    8
    >>> threads_per_job("LocalLauncher", n_jobs=None, cpus_per_task=None, planned=8, cores=16)
    2
    >>> threads_per_job("BasicLauncher", n_jobs=None, cpus_per_task=None, planned=8, cores=16)
    """
    if cpus_per_task is not None:
        return cpus_per_task
    if launcher == "JoblibLauncher" and n_jobs:
        at_once = n_jobs if n_jobs > 0 else max(1, cores + 1 + n_jobs)
    elif launcher == "LocalLauncher":  # submitit starts all jobs at the same time
        at_once = planned or 1
    else:
        return None
    return max(1, cores // min(at_once, planned or at_once))
