"""Simulates all rigs on all cores and writes their folders, each rig whole or not at all."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from uncal.errors import ConfigurationError, RecordingError
from uncal.simulation.formats.drive import Piece
from uncal.simulation.manifest import PARTIAL_PREFIX, Layout, layout_of, missing_rigs
from uncal.simulation.settings import SimulationSettings
from uncal.system.locking import note_reading
from uncal.system.memory import keep_freed_memory
from uncal.system.progress import progress_bar

log = logging.getLogger(__name__)

PIECE_FRAMES = 50
"""Frames of a drive that one task simulates; fixed, so that results never depend on the machine."""

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def write_rigs(
    settings: SimulationSettings, root: Path, todo: list[int], workers: int, progress: bool
) -> None:
    """Simulate rigs; the caller holds the lock of ``root``."""
    begin = time.perf_counter()
    layout = layout_of(settings)
    partial = {index: root / f"{PARTIAL_PREFIX}{index:04d}" for index in todo}
    pieces = [piece for index in todo for piece in pieces_of(settings, index)]
    open_pieces = dict.fromkeys(todo, len(pieces) // len(todo))
    per_rig = settings.drives_per_rig * settings.frames_per_drive
    bar = progress_bar(
        "simulating",
        settings.n_frames,
        done=settings.n_frames - per_rig * len(todo),
        unit="frame",
        quiet=not progress,
    )
    with _process_pool(min(workers, len(pieces))) as pool, bar:
        futures: dict[Future[None], Piece] = {}
        for index in todo:
            layout.prepare(index, partial[index])
        for piece in pieces:
            futures[pool.submit(layout.write, piece, partial[piece.rig])] = piece
        try:
            for future in as_completed(futures):
                future.result()
                piece = futures[future]
                bar.update(piece.last - piece.first)
                open_pieces[piece.rig] -= 1
                if not open_pieces[piece.rig]:
                    layout.finish(piece.rig, partial[piece.rig])
                    publish(layout, piece.rig, partial[piece.rig], root)
        except BrokenProcessPool as error:
            raise RecordingError(
                "a simulating process was killed, perhaps for lack of memory; run again (finished "
                "rigs are kept) with fewer workers"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    seconds, frames = time.perf_counter() - begin, per_rig * len(todo)
    log.info("simulated %d frames in %.1f s (%.1f/s)", frames, seconds, frames / seconds)


def pieces_of(settings: SimulationSettings, index: int) -> list[Piece]:
    """The tasks of one rig."""
    total = settings.frames_per_drive
    return [
        Piece(index, drive, first, min(first + PIECE_FRAMES, total))
        for drive in range(settings.drives_per_rig)
        for first in range(0, total, PIECE_FRAMES)
    ]


def publish(layout: Layout, rig: int, partial: Path, root: Path) -> None:
    """Give the folders of a finished rig their names; incomplete ones of that name are replaced."""
    for name in layout.folders(rig):
        final = root / name
        if final.exists():
            shutil.rmtree(final)
        final.parent.mkdir(exist_ok=True)
        (partial / name).rename(final)
    shutil.rmtree(partial)


@contextlib.contextmanager
def _process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Fresh interpreters: forking a process that has loaded torch and its threads is not safe."""
    before = {name: os.environ.get(name) for name in THREAD_LIMITS}
    # Read by numpy's BLAS when a worker imports it, so it must be set before the worker starts.
    os.environ.update(dict.fromkeys(THREAD_LIMITS, "1"))
    try:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, context, initializer=_start_worker) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _start_worker() -> None:
    """Keep memory, and end without a traceback on Ctrl-C and when the parent dies.

    Left alone, the workers of a killed parent would wait for their next task for ever.
    """
    keep_freed_memory()
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    signal.signal(signal.SIGINT, lambda *_: os._exit(1))
    threading.Thread(target=watch, daemon=True).start()


def ensure_simulated(
    settings: SimulationSettings, root: Path, workers: int | None = None, progress: bool = True
) -> Path:
    """Make ``root`` hold exactly this simulation, doing only what is missing; gives ``root``.

    A finished simulation of the same fingerprint is reused after a look at its file counts; an
    interrupted one is resumed; one of other settings or another simulator version is replaced. The
    result does not depend on the number of ``workers`` (None: one per available core).

    Raises:
        RecordingError: ``root`` holds something that this simulator did not write, or another
            simulation that another process reads; it is left untouched. Or a worker died.
        ConfigurationError: ``workers`` is not positive.
    """
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise ConfigurationError(f"workers is {workers!r}; it must be at least 1, or null for all")
    with missing_rigs(settings, root) as missing:
        if missing:
            write_rigs(settings, root, missing, workers or available_cores(), progress)
        note_reading(root)
    return root
