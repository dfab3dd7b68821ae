"""``python -m uncal.monitor`` from recordings to verdicts, with the shipped weights."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator  # type: ignore[import-untyped]

from uncal.monitor.run_folder import COLUMNS
from uncal.monitor.verdict import VERDICTS

Run = Callable[..., "subprocess.CompletedProcess[str]"]

COMMAND = "uncal.monitor.__main__"
DRIVES = [f"2041_01_0{number}_drive_0001_sync" for number in (1, 2, 3)]


def lines(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "monitor.jsonl").read_text().splitlines()]


def watch(
    start: Run, source: Path, references: Path, folder: Path, drives: list[str], *words: str
) -> subprocess.CompletedProcess[str]:
    return start(
        COMMAND,
        f"source={source}",
        f"references={references}",
        f"drives=[{','.join(drives)}]",
        f"hydra.run.dir={folder}",
        *words,
        cwd=folder.parent,
    )


def test_every_frame_gets_a_verdict_and_a_run_goes_on_where_it_was(
    recorded: Path, references: Path, settings: tuple[str, ...], tmp_path: Path, start: Run
) -> None:
    source = tmp_path / "source"
    shutil.copytree(recorded, source)
    spoilt = source / "2041_01_02" / DRIVES[1] / "velodyne_points" / "data" / "0000000001.bin"
    spoilt.write_bytes(b"123")
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    done = watch(start, source, references, whole, DRIVES, "overlays=4", *settings)
    assert done.returncode == 0, done.stderr
    assert "12 frames: " in done.stdout
    assert "frames a second" in done.stdout

    said = lines(whole)
    assert len(said) == 12
    for line in said:
        assert {"frame", "correction", "lower", "upper", "verdict", "reason"} <= set(line)
        assert line["verdict"] in VERDICTS
    (missing,) = [line for line in said if str(spoilt.name)[:10] in str(line["reason"])]
    assert missing["verdict"] == "untrusted"
    assert str(missing["frame"]).endswith("drive_0001_sync/0000000001")
    with (whole / "monitor.csv").open() as file:
        table = list(csv.DictReader(file))
    assert list(table[0]) == list(COLUMNS)
    wanted = 100 * cast("list[float]", said[0]["correction"])[0]
    assert np.isclose(float(table[0]["correction_x"]), wanted, atol=1e-3)

    events = EventAccumulator(str(whole / "tensorboard")).Reload()
    curve = [event.value for event in events.Scalars("correction/X")]
    assert len(curve) == 12
    assert np.isclose(curve[0], wanted, atol=1e-3)
    assert {"lower/Yaw", "upper/Roll", "sigma/Z", "verdict"} <= set(events.Tags()["scalars"])
    drawn = sorted(path.name for path in (whole / "overlays").iterdir())
    assert len(drawn) == 3
    assert drawn[0] == f"2041_01_01_{DRIVES[0]}_0000000000.png"

    assert watch(start, source, references, pieces, DRIVES[:1], *settings).returncode == 0
    assert len(lines(pieces)) == 4
    # Killed between the line and the state: the line is said again, not twice.
    with (pieces / "monitor.jsonl").open("a") as file:
        file.write('{"frame": "cut')
    again = watch(start, source, references, pieces, DRIVES, *settings)
    assert again.returncode == 0, again.stderr
    for name in ("monitor.jsonl", "monitor.csv", "extrinsics.jsonl"):
        assert (pieces / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["weights=unical"], "source=None, calibrate=None: give one of them"),
        (["source=x"], "weights=None, ckpt=None: give one of them"),
        (["weights=unical", "source=nowhere"], "source=nowhere: no such folder"),
        (["weights=unical", "source=.", "window=zero"], "window=zero"),
        (["weights=unical", "source=.", "+wide=3"], "wide: nothing reads this"),
        (["weights=unical", "source=.", "limits.width_cm=-1"], "limits.width_cm=-1"),
        (["weights=unical", "source=.", "extrinsic=x.yaml"], "is a folder, of which nothing reads"),
        (
            ["weights=unical", "source=.", "camera_topic=/x"],
            "camera_topic=/x: source=. is a fold",
        ),
        (["weights=unical", "source=a.bag", "camera=left"], "camera=left: source=a.bag is a bag"),
        (
            ["weights=unical", "calibrate=.", "references=a.bag/x.npz"],
            "a file, where a folder mu",
        ),
    ],
)
def test_what_cannot_be_is_said(words: list[str], named: str, tmp_path: Path, start: Run) -> None:
    (tmp_path / "a.bag").touch()
    done = start(COMMAND, *words, cwd=tmp_path)
    assert done.returncode != 0
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_references_of_another_window_are_refused(
    recorded: Path, references: Path, settings: tuple[str, ...], tmp_path: Path, start: Run
) -> None:
    done = start(
        COMMAND,
        f"source={recorded}",
        f"references={references}",
        *settings,
        "window=3",
        cwd=tmp_path,
    )
    assert done.returncode != 0
    assert "window: 2, here 3" in done.stderr


def test_a_recording_for_the_viewer(
    recorded: Path, references: Path, settings: tuple[str, ...], tmp_path: Path, start: Run
) -> None:
    pytest.importorskip("rerun", reason="the rerun SDK is not installed (uncal[rerun])")
    words = ("rerun=true", "tensorboard=false", *settings)
    done = watch(start, recorded, references, tmp_path / "run", DRIVES[:1], *words)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "monitor.rrd").read_bytes().startswith(b"RRF2")
    assert not (tmp_path / "run" / "tensorboard").exists()


def test_without_the_viewer_a_recording_is_refused(
    recorded: Path,
    references: Path,
    settings: tuple[str, ...],
    tmp_path: Path,
    start: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    words = ("rerun=true", *settings)
    done = watch(start, recorded, references, tmp_path / "run", DRIVES[:1], *words)
    assert done.returncode != 0
    assert "pip install 'uncal[rerun]'" in done.stderr
