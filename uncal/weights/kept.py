"""What is trained stays, whatever goes wrong after it, and the message says how to finish."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uncal.errors import DivergenceError, UncalError

log = logging.getLogger(__name__)


@contextmanager
def stays_trained(checkpoint: Path) -> Iterator[None]:
    """Say how to go on with trained weights if what follows the training fails.

    Raises:
        UncalError: what was raised, with the command that finishes the job.

    >>> with stays_trained(Path("best.ckpt")):
    ...     raise UncalError("interval.levels=[1.0]: expected …")
    Traceback (most recent call last):
    uncal.errors.UncalError: interval.levels=[1.0]: expected …
    The training is done and kept. With that put right, this finishes without training:
      python -m uncal.evaluate ckpt=best.ckpt
    """
    try:
        yield
    except DivergenceError:
        raise
    except UncalError as error:
        raise UncalError(f"{error}\n{how_to_finish(checkpoint)}") from error
    except Exception:
        log.error(how_to_finish(checkpoint))  # the traceback follows by itself
        raise


def how_to_finish(checkpoint: Path) -> str:
    """The command that makes the table of trained weights.

    >>> print(how_to_finish(Path("out/a b/best.ckpt")).splitlines()[1])
      python -m uncal.evaluate 'ckpt="out/a b/best.ckpt"'
    """
    return (
        "The training is done and kept. With that put right, this finishes without training:\n"
        f"  python -m uncal.evaluate {override('ckpt', checkpoint)}"
    )


def override(key: str, path: Path) -> str:
    """A path as a word of a command line, quoted for Hydra and for the shell.

    >>> print(override("ckpt", Path("out/a=1/best.ckpt")))
    'ckpt="out/a=1/best.ckpt"'
    """
    text = str(path)
    plain = all(letter.isalnum() or letter in "/._-" for letter in text)
    if plain:
        return shlex.quote(f"{key}={text}")
    escaped = text.replace('"', '\\"')
    return shlex.quote(f'{key}="{escaped}"')
