"""Trained weights, found again or trained now; they stay, whatever goes wrong after it."""

from __future__ import annotations

import logging
import os
import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only

from uncal.errors import DivergenceError, UncalError
from uncal.reporting.run_record import commit_of_code
from uncal.weights.store import Trained, WeightStore

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Weights:
    """Weights that a run works with.

    Attributes:
        path: of their checkpoint.
        fingerprint: of what went into them; empty where the user named a checkpoint to go on from.
        reused: whether an earlier run trained them.
        trained: how they came about; None where nothing keeps it.
        learnt: whether there is anything to learn.
    """

    path: Path
    fingerprint: str
    reused: bool
    trained: Trained | None
    learnt: bool = True

    def sentence(self) -> str:
        """For the log and the report."""
        if not self.learnt:
            return "No training: this model has no parameters."
        if self.trained is None:
            return (
                f"Weights of {self.path}."
                if self.reused
                else "Weights trained in this run; not kept for others."
            )
        took = f"{self.trained.epochs} epochs, {self.trained.seconds:.0f} s"
        if not self.reused:
            return f"Weights {self.fingerprint} trained in this run ({took})."
        return (
            f"Weights {self.fingerprint} reused, not trained again: trained by {self.trained.run} "
            f"at {self.trained.finished} ({took}). retrain=true trains anew."
        )


def load_or_train(
    store: WeightStore,
    train: Callable[[Path | None], Path],
    *,
    run: Path,
    epochs: int,
    last: Path | None,
    retrain: bool,
) -> Weights:
    """Find weights, or train them while no other process does.

    A training that was interrupted goes on after its last finished epoch.

    Args:
        store: knows what goes into the weights.
        train: trains, from a checkpoint of an interrupted training or from nothing; gives the path
            of the best checkpoint.
        run: folder of this run.
        epochs: of the training.
        last: where this run keeps its last epoch; None if it does not.
        retrain: train even if the weights, or a part of the way to them, are there.
    """
    if _is_follower():
        # Its leader holds the lock and waits for it; both see the same files.
        found = None if retrain else store.find()
        if found is not None:
            return Weights(store.checkpoint, store.fingerprint, True, found)
        start = None if retrain else store.interrupted()
        return Weights(train(start), store.fingerprint, False, None)
    with store.locked():
        found = None if retrain else store.find()
        if found is not None:
            weights = Weights(store.checkpoint, store.fingerprint, True, found)
            log.info(weights.sentence())
            return weights
        start = None if retrain else store.interrupted()
        if start is not None:
            log.info("going on with the interrupted training of %s", start)
        store.begin(start or last)
        commit, began = commit_of_code(), time.monotonic()
        best = train(start)
        trained = Trained(
            seconds=round(time.monotonic() - began, 1),
            epochs=epochs,
            finished=datetime.now().isoformat(timespec="seconds"),
            run=os.path.relpath(run),
            commit=commit,
        )
        store.keep(best, trained)
        return Weights(best, store.fingerprint, False, trained)


def _is_follower() -> bool:
    """Whether Lightning started this process to help another one."""
    return int(getattr(rank_zero_only, "rank", 0)) > 0


@contextmanager
def stays_trained(checkpoint: Path) -> Iterator[None]:
    """Say which command finishes the job if what follows the training fails.

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
    if not all(letter.isalnum() or letter in "/._-" for letter in text):
        escaped = text.replace('"', '\\"')
        text = f'"{escaped}"'
    return shlex.quote(f"{key}={text}")
