"""Trained weights, found again or trained now; they stay, whatever goes wrong after it."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shlex
import shutil
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only

from uncal.errors import DivergenceError, UncalError
from uncal.reporting.layout import read_json, replaced_whole, write_whole
from uncal.reporting.run_record import commit_of_code
from uncal.system.locking import locked
from uncal.weights.digest import digest_of

log = logging.getLogger(__name__)

CHECKPOINT = "best.ckpt"
RECORD = "trained.json"
INGREDIENTS = "ingredients.json"
UNFINISHED = "unfinished.json"
LOCK = ".lock"


@dataclass(frozen=True)
class Trained:
    """How some weights came about."""

    seconds: float  # wall time of the training; of its last part, where it was interrupted
    epochs: int  # epochs of the training
    finished: str  # when, ISO 8601
    run: str  # folder of the run that trained them
    commit: str | None  # of the code; None outside a repository


class WeightStore:
    """Trained weights by what went into them.

    Args:
        folder: where they are kept; made when the first are.
        ingredients: everything that decides what the weights are, as plain values.
    """

    def __init__(self, folder: Path, ingredients: Mapping[str, object]) -> None:
        self.ingredients = ingredients
        self.fingerprint = digest_of(ingredients)
        self.folder = folder / self.fingerprint

    @property
    def checkpoint(self) -> Path:
        """Where the weights are, once they are."""
        return self.folder / CHECKPOINT

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold these weights, so that no other process trains them too."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with locked(self.folder / LOCK, f"trains the same weights ({self.fingerprint})"):
            yield

    def find(self) -> Trained | None:
        """The record of finished weights; None if there are none, or not whole."""
        if not self.checkpoint.is_file():
            return None
        content = read_json(self.folder / RECORD, "not used")
        try:
            return None if content is None else Trained(**content)  # type: ignore[arg-type]
        except TypeError:
            log.warning("%s is not of this version: not used", self.folder / RECORD)
            return None

    def interrupted(self) -> Path | None:
        """The checkpoint after the last epoch of a training that did not end; None without one."""
        content = read_json(self.folder / UNFINISHED, "not used")
        last = None if content is None else Path(str(content.get("last")))
        if last is None or not last.is_file():
            return None
        # The table of contents stands at the end: a file that was cut short has none.
        if not zipfile.is_zipfile(last):
            log.warning("%s is damaged: the interrupted training is not gone on with", last)
            return None
        return last

    def begin(self, last: Path | None) -> None:
        """Note where a training that starts now keeps its last epoch."""
        text = json.dumps(self.ingredients, indent=1, sort_keys=True)
        write_whole(self.folder / INGREDIENTS, f"{text}\n")
        (self.folder / RECORD).unlink(missing_ok=True)
        if last is None:
            (self.folder / UNFINISHED).unlink(missing_ok=True)
        else:
            note = json.dumps({"last": str(last.resolve())})
            write_whole(self.folder / UNFINISHED, f"{note}\n")

    def keep(self, checkpoint: Path, trained: Trained) -> None:
        """Keep finished weights; a reader sees them whole or not at all."""
        with replaced_whole(self.checkpoint) as partial:
            shutil.copyfile(checkpoint, partial)
        write_whole(self.folder / RECORD, f"{json.dumps(asdict(trained), indent=1)}\n")
        (self.folder / UNFINISHED).unlink(missing_ok=True)


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
