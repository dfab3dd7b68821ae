"""A full disk ends a run with a sentence, and leaves what was there."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import numpy as np
import pytest
import torch

from uncal.errors import ConfigurationError
from uncal.recordings.sensor_files import write_image
from uncal.reporting.layout import write_whole
from uncal.runs.checkpoint import WholeCheckpoints, save_weights
from uncal.settings.configuration import exits_on_error
from uncal.settings.guard import names_the_setting
from uncal.system.disk import check_writable, disk_trouble


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


class OutOfMemoryError(RuntimeError):
    """As torch names its own."""


@pytest.mark.parametrize(
    "error",
    [
        OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nGPU 0 has …"),
        RuntimeError("DataLoader worker (pid 7) is killed by signal: Killed. "),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried"),
        MemoryError(),
    ],
)
def test_so_they_do_of_memory(error: Exception) -> None:
    @exits_on_error
    def main() -> None:
        raise RuntimeError("caught in a loop") from error

    with pytest.raises(SystemExit, match=r"^[^\n]*\. Lower dataset\.loader\.batch_size"):
        main()


def test_what_hides_a_full_disk_is_looked_through() -> None:
    outer = ValueError("cannot save")
    outer.__cause__ = full()
    assert str(disk_trouble(outer)).startswith("out/results.csv: no space left")
    assert disk_trouble(OSError(errno.ENOENT, "x", "y")) is None
    read_only = OSError(errno.EROFS, os.strerror(errno.EROFS), "out")
    assert "out: the disk can only be read" in str(disk_trouble(read_only))


def test_libraries_in_rust_pass_the_number_on() -> None:
    error = RuntimeError('I/O error: Permission denied (os error 13) at path "out/.tmp7"')
    assert str(disk_trouble(error)).startswith("out/.tmp7: permission denied. Name another")
    assert "no space left" in str(disk_trouble(RuntimeError("I/O error: … (os error 28)")))
    assert disk_trouble(RuntimeError("No such file or directory (os error 2)")) is None


def test_a_constructor_that_may_not_read_names_the_path() -> None:
    @names_the_setting("dataset")
    def build() -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "data/2011_09_26")

    with pytest.raises(ConfigurationError, match=r"^data/2011_09_26: permission denied\. Name"):
        build()


def test_a_file_that_cannot_be_written_is_found_before_the_work(tmp_path: Path) -> None:
    there = tmp_path / "there.onnx"
    there.write_text("whole")
    check_writable(there)
    check_writable(tmp_path / "new" / "a.onnx")
    assert there.read_text() == "whole"
    assert list((tmp_path / "new").iterdir()) == []
    for path, said in (
        (tmp_path / "new", "a folder, where a file"),
        (there / "b", "a file, where"),
    ):
        with pytest.raises(OSError, match=r".") as raised:
            check_writable(path)
        assert said in str(disk_trouble(raised.value))


def test_what_hydra_meets_before_a_job_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended = subprocess.run(
        [sys.executable, "-m", "uncal.train", "hydra.run.dir=file/run"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1
    assert "a file, where a folder must be. Name another place (hydra.run.dir=" in ended.stderr
    assert "Traceback" not in ended.stderr


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


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 20 MB in memory; skipped where nothing may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    command = [str(mount), "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(folder)]
    if mount is None or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("a full disk needs the right to mount one")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(folder: Path, leave: int) -> None:
    """Leave so many bytes free."""
    free = shutil.disk_usage(folder).free
    (folder / "filler").write_bytes(bytes(max(0, free - leave)))


def test_what_is_saved_on_a_full_disk_stays_as_it_was(small_disk: Path) -> None:
    last = small_disk / "checkpoints" / "last.ckpt"
    save = WholeCheckpoints().save_checkpoint
    save({"weights": torch.zeros(10_000)}, last)
    fill(small_disk, 100_000)

    @exits_on_error
    def main() -> None:
        save({"weights": torch.zeros(1_000_000)}, last)

    with pytest.raises(SystemExit, match="no space left on the disk"):
        main()
    assert torch.load(last, weights_only=True)["weights"].shape == (10_000,)
    assert [path.name for path in last.parent.iterdir()] == ["last.ckpt"]


@pytest.mark.parametrize("leave", [0, 8192, 49_152])
def test_half_a_picture_is_an_error(small_disk: Path, leave: int) -> None:
    """OpenCV's own writer leaves 49152 of 50155 bytes and says that all is well."""
    fill(small_disk, leave)
    noise = np.random.default_rng(0).integers(0, 255, (80, 208, 3), np.uint8)
    with pytest.raises(OSError, match="No space left") as raised:
        write_image(small_disk / "0.png", noise)
    assert disk_trouble(raised.value)


@pytest.mark.slow
@pytest.mark.parametrize("leave", [0, 400_000, 3_000_000])
def test_a_run_on_a_full_disk_ends_with_one_sentence(small_disk: Path, leave: int) -> None:
    fill(small_disk, leave)
    ended = subprocess.run(
        [sys.executable, "-m", "uncal.train", "dataset.simulation.n_rigs=60"],
        cwd=small_disk,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 1
    assert "no space left on the disk" in ended.stderr
    assert "Traceback" not in ended.stderr
