"""What a multirun is going to do: its jobs, and the threads that each of them may use."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig

from uncal.multirun.jobs import as_mapping

log = logging.getLogger(__name__)

THREADS = "OMP_NUM_THREADS"


def planned_jobs(config: DictConfig) -> list[dict[str, str]] | None:
    """The overrides of every job in order, key → value; None if only the sweeper knows them.

    It does where it looks at results before it goes on, or will refuse the command line.
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
