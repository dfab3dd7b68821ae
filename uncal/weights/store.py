"""A folder of trained weights, each in a folder named by the fingerprint of what made it."""

from __future__ import annotations

import contextlib
import json
import logging
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from uncal.reporting.layout import read_json, replaced_whole, write_whole
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
