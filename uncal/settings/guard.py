"""What a library says of a user's setting, put into a sentence that names the setting."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from omegaconf import OmegaConf

from uncal.errors import ConfigurationError, UncalError
from uncal.system.disk import disk_trouble

P = ParamSpec("P")
R = TypeVar("R")

_WHERE = re.compile(r"^full_key: (.+)$", re.MULTILINE)
_TARGET = re.compile(r"target '([^']+)'")


def names_the_setting(*groups: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make what goes wrong in building from groups of settings a :class:`ConfigurationError`.

    >>> @names_the_setting("trainer")
    ... def build() -> None:
    ...     raise ValueError("no such strategy")
    >>> build()
    Traceback (most recent call last):
    uncal.errors.ConfigurationError: trainer: no such strategy
    """

    def decorate(build: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(build)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return build(*args, **kwargs)
            except UncalError:
                raise
            except InstantiationException as error:
                raise explain(error) from error
            # Whatever it is: these functions do nothing but follow the settings.
            except Exception as error:
                raise _in_a_sentence(" and ".join(groups), error, groups) from error

        return guarded

    return decorate


def explain(error: InstantiationException) -> UncalError:
    """Our own error out of what Hydra wraps around it; another one as a sentence."""
    cause = error.__cause__
    while isinstance(cause, InstantiationException):
        cause = cause.__cause__
    if isinstance(cause, UncalError):
        return cause
    where, target = _WHERE.search(str(error)), _TARGET.search(str(error))
    key = where[1] if where else "the configuration"
    made = f"{key} ({target[1]})" if target else key
    return _in_a_sentence(made, cause or error, (key,))


def _in_a_sentence(
    subject: str, error: BaseException, groups: tuple[str, ...]
) -> ConfigurationError:
    """What is refused by the disk concerns a path; anything else, a setting."""
    return ConfigurationError(disk_trouble(error) or _sentence(subject, error, groups))


def _sentence(subject: str, error: BaseException, groups: tuple[str, ...]) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reason = lines[0] if lines else type(error).__name__
    given = [name for name in _given() if name.startswith(tuple(f"{g}." for g in groups))]
    given = given or _given()
    hint = f"; you set {', '.join(given)}: take it back or choose another value" if given else ""
    return f"{subject}: {reason}{hint}"


def _given() -> list[str]:
    """The values that the command line sets, as it says them."""
    if not HydraConfig.initialized():
        return []
    return [word.lstrip("+") for word in task_words()]


def task_words() -> list[str]:
    """The overrides of the run that Hydra has started, as typed."""
    # Not resolved: of ${…} that is not there, a check of the settings says more.
    words = OmegaConf.to_container(HydraConfig.get().overrides.task, resolve=False)
    return [str(word) for word in cast("list[object]", words)]
