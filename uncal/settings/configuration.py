"""Where the YAML lives, and how entry points end when a user's input is wrong."""

from __future__ import annotations

import functools
import logging
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

from hydra._internal import utils as hydra_utils
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException, InstantiationException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from uncal.errors import ConfigurationError, UncalError
from uncal.settings import sweep_source
from uncal.settings.guard import explain, task_words
from uncal.settings.refusals import refusal
from uncal.system.disk import disk_trouble
from uncal.system.memory import memory_trouble
from uncal.system.output import outlive_readers

P = ParamSpec("P")
R = TypeVar("R")

FULL_ERROR = "HYDRA_FULL_ERROR"
"""Environment variable; 1 shows the whole traceback in place of the message alone."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as a shell gives it (128 + SIGINT)."""


def find_config_dir(package: Path) -> str:
    """Absolute path of the configuration folder.

    Raises:
        ConfigurationError: neither exists.
    """
    candidates = [package.parent / "conf", package / "conf"]
    for candidate in candidates:
        if (candidate / "simulate.yaml").is_file():
            return str(candidate)
    raise ConfigurationError(
        f"no configuration folder at {' or '.join(map(str, candidates))}; reinstall uncal"
    )


CONFIG_DIR: str = find_config_dir(Path(__file__).resolve().parents[1])
"""For ``hydra.main(config_path=CONFIG_DIR, ...)``."""

sweep_source.register()


def group_names(folder: Path) -> list[str]:
    """The configuration groups in a folder, such as model/backbone.

    Args:
        folder: with a folder for each.
    """
    within = {path.parent.relative_to(folder).as_posix() for path in folder.rglob("*.yaml")}
    return sorted(within - {"."})


def _reports_in_a_sentence(
    report: Callable[[Callable[[], R]], R],
) -> Callable[[Callable[[], R]], R]:
    """Make what Hydra meets outside a job, such as a misspelt key or a full disk, a sentence too.

    Args:
        report: Hydra's own, which calls a function and prints what goes wrong.
    """

    @functools.wraps(report)
    def reported(function: Callable[[], R]) -> R:
        def explained() -> R:
            try:
                return function()
            except KeyboardInterrupt:
                raise SystemExit(INTERRUPTED) from None
            except Exception as error:
                trouble = disk_trouble(error)
                if trouble is None and isinstance(error, HydraException | OmegaConfBaseException):
                    trouble = refusal(error, group_names(Path(CONFIG_DIR)))
                if trouble is None or os.environ.get(FULL_ERROR) == "1":
                    raise
                sys.stderr.write(f"{trouble}\n")
                raise SystemExit(1) from error

        return report(explained)

    return reported


# Hydra composes, and makes the run's folder, before a job starts, and offers no hook there.
hydra_utils.run_and_report = _reports_in_a_sentence(  # type: ignore[assignment]
    hydra_utils.run_and_report
)


def exits_on_error(main: Callable[P, R]) -> Callable[P, R]:
    """Make an entry point end with the message alone and exit code 1 on an :class:`UncalError`.

    Ctrl-C ends it without a traceback too. Stands below ``@hydra.main``, which would otherwise
    print one; ``HYDRA_FULL_ERROR=1`` brings the traceback back. In a multirun the error ends its
    own job only: the other jobs run, then Hydra prints the message and ends with exit code 1.
    Ctrl-C ends the whole multirun.

    >>> @exits_on_error
    ... def main() -> None:
    ...     raise UncalError("no frames in /data; set root=...")
    >>> main()
    Traceback (most recent call last):
    SystemExit: no frames in /data; set root=...
    """

    @functools.wraps(main)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        outlive_readers()
        try:
            return main(*args, **kwargs)
        except UncalError as error:
            if os.environ.get(FULL_ERROR) == "1":
                raise
            raise _ending(error) from error
        except InstantiationException as error:
            if os.environ.get(FULL_ERROR) == "1":
                raise
            # Hydra wraps what a constructor raises, and shows its line breaks as \\n.
            raise _ending(explain(error)) from error
        except KeyboardInterrupt:
            raise SystemExit(INTERRUPTED) from None
        except Exception as error:
            trouble = disk_trouble(error) or memory_trouble(error)
            if trouble is None or os.environ.get(FULL_ERROR) == "1":
                raise
            raise _ending(UncalError(trouble)) from error

    return wrapped


def _ending(error: UncalError) -> BaseException:
    interrupted = isinstance(error.__cause__, SystemExit | KeyboardInterrupt)
    multirun = HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN
    if multirun and not interrupted:
        # Hydra's launcher notes an Exception as its job's failure, but SystemExit passes through;
        # of this class it prints the message without a traceback.
        return CompactHydraException(str(error))
    return SystemExit(str(error))


def job_folder() -> Path:
    """The output folder of the run that Hydra has started."""
    return Path(HydraConfig.get().runtime.output_dir)


def job_overrides() -> list[str]:
    """What tells this run from the default one, as words of a command line."""
    hydra = HydraConfig.get()
    folders = [
        source.path
        for source in hydra.runtime.config_sources
        if source.provider == "command-line" and source.schema == "file"
    ]
    # As one would type it: Hydra has made the path absolute.
    typed = [os.path.relpath(path) for path in folders]
    return [*(part for path in typed for part in ("-cd", path)), *task_words()]


def in_multirun() -> bool:
    """Whether this run is a job of a multirun."""
    return bool(HydraConfig.get().mode == RunMode.MULTIRUN)


def quiet_libraries() -> None:
    """Silence what a user cannot act on, and print warnings as the sentences they are."""
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",
        ".*isinstance.treespec, LeafSpec.*",
        ".*Checkpoint directory .* exists and is not empty.*",
        ".*The number of training batches .* is smaller than the logging interval.*",
    ):
        warnings.filterwarnings("ignore", message=message)
