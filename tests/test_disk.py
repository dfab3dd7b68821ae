"""A full disk ends a run with a sentence, and leaves what was there."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import pytest
import torch

from uncal.checkpoint import save_weights
from uncal.configuration import exits_on_error
from uncal.disk import disk_trouble
from uncal.reporting.layout import write_whole


def full(path: object = "out/results.csv") -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@pytest.mark.parametrize(
    "error",
    [
        full(),
        RuntimeError("[enforce fail at inline_container.cc:659] . PytorchStreamWriter failed"),
        OSError("Can't write data (errno = 28, error message = 'No space left on device')"),
    ],
)
def test_entry_points_say_it_in_a_sentence(error: Exception) -> None:
    @exits_on_error
    def main() -> None:
        raise error

    with pytest.raises(SystemExit, match="no space left on the disk"):
        main()


def test_what_hides_a_full_disk_is_looked_through() -> None:
    outer = ValueError("cannot save")
    outer.__cause__ = full()
    assert str(disk_trouble(outer)).startswith("out/results.csv: no space left")
    assert disk_trouble(OSError(errno.ENOENT, "x", "y")) is None
    read_only = OSError(errno.EROFS, os.strerror(errno.EROFS), "out")
    assert "out: the disk can only be read" in str(disk_trouble(read_only))


def test_tables_and_weights_stay_as_they_were(tmp_path: Path) -> None:
    table, weights = tmp_path / "results.csv", tmp_path / "best.ckpt"
    table.write_text("whole")
    weights.write_text("whole")

    class Module:
        recipe: ClassVar[dict[str, object]] = {}

        def state_dict(self) -> dict[str, torch.Tensor]:
            return {}

    def writes_half(path: Path, content: object) -> None:
        path.write_text("half")
        raise full(path)

    with (
        patch.object(Path, "write_bytes", writes_half),
        pytest.raises(OSError, match="No space left"),
    ):
        save_weights(Module(), weights)  # type: ignore[arg-type]  # what is used of a module
    with (
        patch.object(Path, "write_text", side_effect=full(table)),
        pytest.raises(OSError, match="No space left"),
    ):
        write_whole(table, "new")
    assert table.read_text() == weights.read_text() == "whole"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best.ckpt", "results.csv"]
