from __future__ import annotations

import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock
from omegaconf import OmegaConf

from uncal.errors import RecordingError
from uncal.simulation import writer
from uncal.simulation.manifest import DRAFT_NAME, LOCK_NAME, Manifest, read_manifest
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]


def contents(root: Path) -> dict[str, bytes]:
    files = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(f.relative_to(root)): f.read_bytes() for f in files if f.name != LOCK_NAME}


def written_at(root: Path) -> dict[str, int]:
    return {str(p.relative_to(root)): p.stat().st_mtime_ns for p in root.rglob("*") if p.is_file()}


@pytest.fixture
def root(tiny_simulation: Path, tmp_path: Path) -> Path:
    """A finished simulation that the test may change."""
    return Path(shutil.copytree(tiny_simulation, tmp_path / "root"))


def test_finished_simulation_is_reused(
    tiny_settings: SimulationSettings, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("simulated again")

    monkeypatch.setattr(writer, "write_rigs", never)
    before = contents(root)
    assert ensure_simulated(tiny_settings, root, progress=False) == root
    assert contents(root) == before


def test_interrupted_simulation_keeps_finished_folders(
    tiny_settings: SimulationSettings, tiny_simulation: Path, root: Path
) -> None:
    (root / "2041_01_02").rename(root / ".partial_2041_01_02")
    Manifest.of(tiny_settings, finished=False).write(root)
    before = written_at(root / "2041_01_01")
    ensure_simulated(tiny_settings, root, workers=1, progress=False)
    assert contents(root) == contents(tiny_simulation)
    assert written_at(root / "2041_01_01") == before


def test_a_missing_frame_is_noticed(
    tiny_settings: SimulationSettings,
    tiny_simulation: Path,
    root: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    data = root / "2041_01_02/2041_01_02_drive_0001_sync/velodyne_points/data"
    (data / "0000000001.bin").unlink()
    with caplog.at_level(logging.WARNING):
        ensure_simulated(tiny_settings, root, workers=1, progress=False)
    assert "1 of 2 rigs are simulated again" in caplog.text
    assert contents(root) == contents(tiny_simulation)


def test_other_settings_replace_the_simulation_but_nothing_else(
    make_settings: MakeSettings, root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (root / "notes.txt").write_text("mine")
    fewer = make_settings(n_rigs=1, seed=7)
    with caplog.at_level(logging.WARNING):
        ensure_simulated(fewer, root, workers=1, progress=False)
    assert "holds a simulation with other settings" in caplog.text
    assert fewer.fingerprint() in caplog.text
    entries = {entry.name for entry in root.iterdir()}
    assert entries == {"2041_01_01", "simulation.json", "notes.txt", LOCK_NAME}


def test_an_edited_manifest_cannot_remove_other_folders(
    make_settings: MakeSettings, root: Path
) -> None:
    outside = root.parent / "outside"
    outside.mkdir()
    manifest = root / "simulation.json"
    manifest.write_text(manifest.read_text().replace('"2041_01_02"', '"../outside"'))
    ensure_simulated(make_settings(n_rigs=1, seed=7), root, workers=1, progress=False)
    assert outside.is_dir()


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("photo.jpg", "", r"not empty and has no simulation\.json.*photo\.jpg"),
        ("simulation.json", "{", r"is not a manifest of this simulator"),
        ("simulation.json", '{"name": "other"}', r"is not a manifest of this simulator"),
    ],
)
def test_foreign_folders_are_left_alone(
    tiny_settings: SimulationSettings, tmp_path: Path, name: str, text: str, message: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=message):
        ensure_simulated(tiny_settings, tmp_path, progress=False)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == text


def test_a_draft_of_a_manifest_alone_is_no_foreign_folder(tmp_path: Path) -> None:
    """What is left of a process that was killed before its first manifest was whole."""
    (tmp_path / LOCK_NAME).write_text("1\n")
    (tmp_path / DRAFT_NAME).write_text('{"generator": ')
    assert read_manifest(tmp_path) is None


def test_a_file_is_no_folder(tiny_settings: SimulationSettings, tmp_path: Path) -> None:
    (tmp_path / "root").write_text("")
    with pytest.raises(RecordingError, match="is a file; name a folder"):
        ensure_simulated(tiny_settings, tmp_path / "root", progress=False)


def test_a_second_process_waits_for_the_first(
    tiny_settings: SimulationSettings, root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lock = FileLock(root / LOCK_NAME)
    with caplog.at_level(logging.INFO):
        lock.acquire()
        (root / LOCK_NAME).write_text("4242")
        waiting = threading.Thread(target=ensure_simulated, args=(tiny_settings, root, 1, False))
        waiting.start()
        waiting.join(timeout=0.3)
        assert waiting.is_alive()
        assert "waiting for process 4242" in caplog.text
        lock.release()
        waiting.join(timeout=10)
        assert not waiting.is_alive()
    assert "reusing the simulation" in caplog.text


READS = """
import sys
from pathlib import Path
from uncal.system.locking import note_reading
note_reading(Path(sys.argv[1]))
print("reads", flush=True)
sys.stdin.read()
"""


def test_what_another_process_reads_is_not_replaced(
    make_settings: MakeSettings, tiny_settings: SimulationSettings, tmp_path: Path
) -> None:
    root, other = tmp_path / "root", make_settings(seed=tiny_settings.seed + 1)
    ensure_simulated(tiny_settings, root, progress=False)
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*.png")}
    command = [sys.executable, "-c", READS, str(root)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as reader:
        assert reader.stdout is not None
        assert reader.stdout.readline() == "reads\n"
        with pytest.raises(RecordingError, match=rf"process {reader.pid} reads now"):
            ensure_simulated(other, root, progress=False)
        ensure_simulated(tiny_settings, root, progress=False)
        assert {path: path.stat().st_mtime_ns for path in root.rglob("*.png")} == before
        reader.communicate()
    ensure_simulated(other, root, progress=False)
    assert not before.keys() & {
        path for path, then in before.items() if path.exists() and path.stat().st_mtime_ns == then
    }


KILLED = """
import sys
from pathlib import Path
from omegaconf import OmegaConf
from uncal.simulation.writer import ensure_simulated
from uncal.simulation.settings import SimulationSettings
if __name__ == "__main__":
    settings = SimulationSettings.from_mapping(OmegaConf.load(sys.argv[1]))
    ensure_simulated(settings, Path(sys.argv[2]), workers=1, progress=False)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_killed_process_leaves_what_another_resumes(
    make_settings: MakeSettings, tmp_path: Path
) -> None:
    settings = make_settings(n_rigs=8, frames_per_drive=6)
    root, script, yaml = tmp_path / "root", tmp_path / "killed.py", tmp_path / "settings.yaml"
    script.write_text(KILLED)
    OmegaConf.save(OmegaConf.create(settings.as_dict()), yaml)
    package = str(Path(writer.__file__).parents[2])
    process = subprocess.Popen(
        [sys.executable, str(script), str(yaml), str(root)],
        env={**os.environ, "PYTHONPATH": package},
    )
    deadline = time.monotonic() + 60
    while not (root / "2041_01_02").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.kill()
    process.wait()
    finished = {path.name: written_at(path) for path in root.glob("2041_*")}
    assert 2 <= len(finished) < 8
    ensure_simulated(settings, root, workers=1, progress=False)
    for name, times in finished.items():
        assert written_at(root / name) == times
    fresh = ensure_simulated(settings, tmp_path / "fresh", workers=2, progress=False)
    assert contents(root) == contents(fresh)
