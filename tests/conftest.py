"""Shared fixtures: tiny recordings in the real layouts, real KITTI frames, entry points started."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import os
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TextIO
from unittest import mock

# Before torch is imported: tests run side by side, and so do the processes that they start.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import numpy as np
import pytest
from forked import Forked
from hydra.core.hydra_config import HydraConfig
from numpy.typing import NDArray

from uncal.recordings.frame import Frame
from uncal.recordings.kitti import KittiRaw
from uncal.settings.command_line import readable
from uncal.settings.configuration import CONFIG_DIR

Run = Callable[..., "subprocess.CompletedProcess[str]"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first, so that at the end no process waits for another's."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


IMAGE_SIZE = (24, 80)
"""Height, width of the generated images."""

_PROJECTIONS = {
    # K of all cameras; offsets of the structure that KITTI has: none, baseline, all three.
    0: (0.0, 0.0, 0.0),
    1: (-0.537, 0.0, 0.0),
    2: (0.0599, -0.0004, 0.0027),
    3: (-0.471, 0.0024, 0.0027),
}
_K = np.array([[46.0, 0.0, 39.5], [0.0, 46.0, 11.0], [0.0, 0.0, 1.0]])


def _rotation(axis: tuple[float, float, float], degrees: float) -> NDArray[np.float64]:
    unit = np.array(axis) / np.linalg.norm(axis)
    return np.array(cv2.Rodrigues(unit * np.radians(degrees))[0], dtype=np.float64)


def _line(key: str, values: NDArray[np.float64]) -> str:
    return f"{key}: " + " ".join(f"{value:.6e}" for value in values.ravel())


def _projection(camera: int) -> NDArray[np.float64]:
    projection: NDArray[np.float64] = _K @ np.column_stack([np.eye(3), _PROJECTIONS[camera]])
    return projection


def _lidar_to_camera(degrees: float) -> NDArray[np.float64]:
    axes_swap = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    rotation: NDArray[np.float64] = _rotation((1.0, 2.0, -1.0), degrees) @ axes_swap
    return rotation


def _write_frame(image_path: Path, scan_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image_path.parent.mkdir(parents=True, exist_ok=True)
    scan_path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(image_path), rng.integers(0, 256, (*IMAGE_SIZE, 3), dtype=np.uint8))
    points = rng.uniform([-20, -20, -2, 0], [20, 20, 2, 1], (50, 4)).astype(np.float32)
    points.tofile(scan_path)


def _write_raw_date(date_folder: Path, degrees: float) -> None:
    date_folder.mkdir(parents=True)
    cameras = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for camera in range(4):
        cameras += [
            _line(f"S_rect_0{camera}", np.array(IMAGE_SIZE[::-1], dtype=np.float64)),
            _line(f"R_rect_0{camera}", _rotation((1.0, 1.0, 0.0), 0.7 + camera)),
            _line(f"P_rect_0{camera}", _projection(camera)),
        ]
    (date_folder / "calib_cam_to_cam.txt").write_text("\n".join(cameras) + "\n")
    lidar = [
        "calib_time: 15-Mar-2012 11:37:16",
        _line("R", _lidar_to_camera(degrees)),
        _line("T", np.array([-0.004, -0.076, -0.272])),
    ]
    (date_folder / "calib_velo_to_cam.txt").write_text("\n".join(lidar) + "\n")
    imu = [_line("R", np.eye(3)), _line("T", np.array([-0.8, 0.3, -0.8]))]
    (date_folder / "calib_imu_to_velo.txt").write_text("\n".join(imu) + "\n")


@pytest.fixture
def kitti_raw_root(tmp_path: Path) -> Path:
    """KITTI raw: 2 dates, drives 0001 (4 frames) and 0002 (3) of the first, 0005 (2) of the second.

    image_02 everywhere and image_00 in drive 0001; timestamps for the first 3 frames of 0001.
    """
    root = tmp_path / "raw"
    _write_raw_date(root / "2011_09_26", degrees=1.0)
    _write_raw_date(root / "2011_09_28", degrees=-2.0)
    for seed, (date, number, n_frames) in enumerate(
        [("2011_09_26", "0001", 4), ("2011_09_26", "0002", 3), ("2011_09_28", "0005", 2)]
    ):
        drive = root / date / f"{date}_drive_{number}_sync"
        for index in range(n_frames):
            scan = drive / "velodyne_points" / "data" / f"{index:010d}.bin"
            for camera in ("image_00", "image_02") if number == "0001" else ("image_02",):
                image = drive / camera / "data" / f"{index:010d}.png"
                _write_frame(image, scan, seed=100 * seed + index)
    times = [f"2011-09-26 13:02:25.{index}00000000" for index in range(3)]
    first = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (first / "image_02" / "timestamps.txt").write_text("\n".join(times) + "\n")
    return root


@pytest.fixture
def kitti_odometry_root(tmp_path: Path) -> Path:
    """KITTI odometry: sequences 00 and 01 of one calibration, 03 of another; 3 frames each."""
    root = tmp_path / "odometry"
    for sequence, degrees in (("00", 1.0), ("01", 1.0), ("03", -2.0)):
        folder = root / "sequences" / sequence
        for index in range(3):
            _write_frame(
                folder / "image_2" / f"{index:06d}.png",
                folder / "velodyne" / f"{index:06d}.bin",
                seed=index,
            )
        lines = [_line(f"P{camera}", _projection(camera)) for camera in range(4)]
        Tr = np.column_stack([_lidar_to_camera(degrees), [-0.012, -0.054, -0.292]])
        (folder / "calib.txt").write_text("\n".join([*lines, _line("Tr", Tr)]) + "\n")
        (folder / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072000e-01\n")
    return root


@pytest.fixture(scope="session")
def kitti_root() -> Path:
    """Real KITTI raw frames: the folder that UNCAL_KITTI names; tests are skipped without it."""
    root = os.environ.get("UNCAL_KITTI")
    if not root:
        pytest.skip("UNCAL_KITTI does not name a folder with real KITTI raw recordings")
    if not Path(root).is_dir():
        pytest.fail(f"UNCAL_KITTI names {root}, which is not a folder")
    return Path(root)


@pytest.fixture(scope="session")
def kitti_frames(kitti_root: Path) -> list[Frame]:
    """Every eighth of the real KITTI frames."""
    recording = KittiRaw(kitti_root, stride=8)
    return [recording.load(frame_id) for frame_id in recording.frame_ids]


@pytest.fixture(autouse=True)
def _logging_as_python_starts_it() -> None:
    """Hydra, started within an earlier test, changed it for the whole process."""
    logging.disable(logging.NOTSET)
    logging.getLogger().setLevel(logging.WARNING)
    for logger in logging.Logger.manager.loggerDict.values():
        if isinstance(logger, logging.Logger):
            logger.disabled = False


TINY = (
    "dataset.simulation.n_rigs=10",
    "dataset.simulation.frames_per_drive=4",
    "dataset.simulation.camera.supersampling=1",
    "dataset.simulation.lidar.beams=32",
    "dataset.loader.batch_size=4",
    "trainer.accelerator=cpu",
)
QUICK = (
    "trainer.max_epochs=1",
    "interval.levels=[0.5]",
    "callbacks.overlays=null",
    "callbacks.figures=null",
    "callbacks.interval_overlays=null",
)


@pytest.fixture(scope="session")
def tiny() -> list[str]:
    """Overrides that make the demo tiny."""
    return list(TINY)


@pytest.fixture(scope="session")
def quick() -> list[str]:
    """Overrides for one epoch, one level and no pictures, where a test looks at none of them."""
    return list(QUICK)


@pytest.fixture(scope="session")
def start() -> Run:
    """``start("uncal.train", *overrides, cwd=folder)``: an entry point within this process.

    What it prints and its exit code are those of ``python -m uncal.train``, without its imports.
    """
    return _start_here


@pytest.fixture(scope="session")
def start_process() -> Run:
    """As :func:`start`, in a process of its own; for tests marked slow."""

    def start(
        module: str, *overrides: str, cwd: Path, without: str = "", timeout: float = 1200
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", module, *overrides],
            cwd=cwd,
            env=_environment(without),
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    return start


@pytest.fixture(scope="session")
def fork() -> Callable[..., Forked]:
    """As :func:`start_process`, without the seconds of imports; returns before its end."""

    def fork(module: str, *overrides: str, cwd: Path) -> Forked:
        return Forked(module, *overrides, cwd=cwd, environment=_environment())

    return fork


@pytest.fixture(scope="session")
def start_forked(fork: Callable[..., Forked]) -> Run:
    """As :func:`fork`, to its end."""

    def start(module: str, *overrides: str, cwd: Path) -> subprocess.CompletedProcess[str]:
        return fork(module, *overrides, cwd=cwd).finished(timeout=1200)

    return start


@pytest.fixture(scope="session")
def interrupt(fork: Callable[..., Forked]) -> Run:
    """As :func:`start_forked`, with Ctrl-C as soon as the file ``after`` is there."""

    def start(
        module: str, *overrides: str, cwd: Path, after: Path
    ) -> subprocess.CompletedProcess[str]:
        started = fork(module, *overrides, cwd=cwd)
        deadline = time.monotonic() + 900
        while not after.exists() and started.is_running() and time.monotonic() < deadline:
            time.sleep(0.05)
        started.send_signal(signal.SIGINT)
        return started.finished(timeout=600)

    return start


def _environment(without: str = "") -> dict[str, str]:
    package = str(Path(__file__).parents[1])
    path = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    added = {"PYTHONUNBUFFERED": "1", "COLUMNS": "110", "PYTHONPATH": path}
    return {key: value for key, value in (os.environ | added).items() if key != without}


def _start_here(module: str, *overrides: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    from lightning.pytorch.utilities.seed import isolate_rng

    main = importlib.import_module(module).main
    stdout, stderr = io.StringIO(), io.StringIO()
    words = readable(overrides, Path(CONFIG_DIR))
    with (
        pytest.MonkeyPatch.context() as patch,
        mock.patch.dict(os.environ, {"COLUMNS": "110"}),
        contextlib.redirect_stdout(stdout),
        contextlib.redirect_stderr(stderr),
        warnings.catch_warnings(),
        isolate_rng(),
    ):
        patch.chdir(cwd)
        patch.setattr(HydraConfig.instance(), "cfg", None)  # a job that never began leaves its own
        patch.setattr(sys, "argv", [module, *words])
        patch.setattr(sys, "orig_argv", ["python", "-m", module, *words])
        warnings.resetwarnings()
        for unseen in (DeprecationWarning, PendingDeprecationWarning, ImportWarning):
            warnings.simplefilter("ignore", unseen)
        patch.setattr(warnings, "formatwarning", warnings.formatwarning)  # to be put back
        patch.setattr(warnings, "showwarning", _show_warning)
        code = _exit_code(main, stderr)
    return subprocess.CompletedProcess(
        [module, *overrides], code, stdout.getvalue(), stderr.getvalue()
    )


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))


def _exit_code(main: Callable[[], object], stderr: io.StringIO) -> int:
    """What Python makes of the way in which a program ends."""
    try:
        main()
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        stderr.write(f"{ended.code}\n")
        return 1
    return 0


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory, start: Run, tiny: list[str]) -> Path:
    """The tiny demo's simulated recordings, shared by all tests; they must not change them."""
    base = tmp_path_factory.getbasetemp()
    # Beside xdist's workers, who wait for the one that simulates.
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "tiny_recordings"
    simulation = [word.removeprefix("dataset.") for word in tiny if ".simulation." in word]
    made = start("uncal.simulate", f"root={folder}", "workers=1", *simulation, cwd=base)
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture(scope="session")
def make_workplace(
    tmp_path_factory: pytest.TempPathFactory, recordings: Path
) -> Callable[[str], Path]:
    """Folders to start entry points from, where the demo finds its recordings simulated."""

    def make(name: str) -> Path:
        folder = tmp_path_factory.mktemp(name)
        (folder / "data").mkdir()
        (folder / "data" / "demo").symlink_to(recordings)
        return folder

    return make


@pytest.fixture(scope="session")
def workplace(make_workplace: Callable[[str], Path]) -> Path:
    """Where the one run of the demo is, in the folder ``first``."""
    return make_workplace("runs")


@pytest.fixture(scope="session")
def demo(workplace: Path, start: Run, tiny: list[str]) -> subprocess.CompletedProcess[str]:
    """One tiny run of the demo for all tests that look at what a run leaves."""
    run = ("trainer.max_epochs=2", "mcd.passes=4", "hydra.run.dir=first")
    finished = start("uncal.train", *tiny, *run, cwd=workplace)
    assert finished.returncode == 0, finished.stderr[-4000:]
    return finished
