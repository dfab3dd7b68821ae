"""What is made of drives at rest is what the simulator would have written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from uncal.simulation.moved import ensure_moved
from uncal.simulation.settings import MotionSettings, SimulationSettings
from uncal.simulation.writer import ensure_simulated


def contents(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.suffix != ".lock" and not path.name.startswith(".")
    }


def test_byte_for_byte(make_settings: Callable[..., SimulationSettings], tmp_path: Path) -> None:
    settings = make_settings()
    keys = ("x_cm", "y_cm", "z_cm", "roll_deg", "pitch_deg", "yaw_deg")
    motion = MotionSettings.from_mapping(
        dict.fromkeys((*keys, "vibration_cm", "vibration_deg"), 0.5)
        | {"first_frame": 1, "ramp_frames": 1, "vibration_hz": 3.0}
    )
    moving = replace(settings, motion=motion, n_rigs=1)
    ensure_simulated(settings, tmp_path / "still", workers=1, progress=False)
    ensure_simulated(moving, tmp_path / "simulated", workers=1, progress=False)
    # Of another motion first: it must be replaced.
    other = replace(moving, motion=replace(motion, x_cm=5.0))
    root = tmp_path / "moved"
    ensure_moved(other, tmp_path / "still", root)
    before = contents(root)
    ensure_moved(moving, tmp_path / "still", root)
    assert contents(root) == contents(tmp_path / "simulated")
    assert contents(root) != before
    (scan,) = root.rglob("0000000001.bin")
    scan.unlink()
    ensure_moved(moving, tmp_path / "still", root)
    assert contents(root) == contents(tmp_path / "simulated")
