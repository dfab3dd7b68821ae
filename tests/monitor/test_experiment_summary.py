"""The tables, against cases worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uncal.geometry import DOF_NAMES
from uncal.monitor.experiment.observe import VECTORS
from uncal.monitor.experiment.page import ABOUT, TITLES, write_tables
from uncal.monitor.experiment.summary import Experiment

ONSET, FRAMES, WINDOW = 4, 10, 2
LIMIT = np.array([0.05] * 3 + [0.01] * 3)
BOUNDS = np.array([0.1] * 3 + [0.02] * 3)


def frame(number: int, **changes: object) -> dict[str, object]:
    """One row of the monitor on a drive at rest that goes well; ``X`` sets ``<name> X`` columns."""
    row: dict[str, object] = {
        **{"watcher": "monitor", "kind": "still", "case": "still", "dof": "", "size": 0.0},
        **{"drive": "a", "number": number, "verdict": "ok", "reason": "", "updated": False},
        **{"full": number >= 1, "joint": True, "alarm": False, "untrusted": False},
        **{f"{name} {dof}": name == "inside" for name in VECTORS for dof in DOF_NAMES},
    }
    row |= {f"{name} {dof}": 0.0 for name in VECTORS if name != "inside" for dof in DOF_NAMES}
    assert set(changes) <= set(row)
    return row | changes


def drive(numbers: dict[int, dict[str, object]], **changes: object) -> list[dict[str, object]]:
    """All frames of a drive, some with changes of their own."""
    return [frame(n, **{**changes, **numbers.get(n, {})}) for n in range(FRAMES)]


def experiment(*drives: list[dict[str, object]]) -> Experiment:
    rows = pd.DataFrame([row for rows in drives for row in rows])
    return Experiment(rows, ONSET, WINDOW, 0.4, LIMIT, BOUNDS)


STEP = {"kind": "step", "case": "step_x", "dof": "X", "size": 5.0}


def test_delay_is_counted_from_the_first_moved_frame() -> None:
    alarm: dict[str, object] = {"alarm": True}
    table = experiment(
        drive({4: alarm}, **STEP, drive="a"),
        drive({1: alarm, 7: alarm, 8: alarm}, **STEP, drive="b"),
        drive({3: alarm}, **STEP, drive="c"),  # before the step: no detection
        drive({6: {"single X": 0.06}, 9: {"mean X": -0.06}}, **STEP, drive="d"),
    ).detection()
    (row,) = table.to_dict("records")
    assert (row["case"], row["dof"], row["size"], row["drives"]) == ("step", "X", 5.0, 4)
    assert row["monitor_detected"] == 50.0
    assert row["monitor_delay"] == 1.5  # 0 and 3
    assert (row["single_detected"], row["single_delay"]) == (25.0, 2.0)
    assert (row["mean_detected"], row["mean_delay"]) == (25.0, 5.0)


def test_alarms_are_runs_of_frames_and_end_with_the_drive() -> None:
    alarm: dict[str, object] = {"alarm": True}
    table = experiment(
        drive({2: alarm, 3: alarm, 6: alarm, 9: alarm}, drive="a"),
        drive({0: alarm, 1: alarm, 5: {"untrusted": True}}, drive="b"),  # 0: no full window
        drive({4: alarm}, **STEP),  # of a drive in which something moves
    ).alarms()
    by = table.set_index("watcher")
    hours = 18 * 0.4 / 3600
    assert by.loc["monitor", "alarms"] == 4
    assert by.loc["monitor", "alarmed_frames"] == pytest.approx(100 * 5 / 18)
    assert by.loc["monitor", "per_hour"] == pytest.approx(4 / hours)
    assert by.loc["monitor: untrusted", "alarms"] == 1
    none = by.loc["running mean, fixed limit"]
    assert none["per_hour"] == 0
    # Of a Poisson process, no event in time t: P = exp(-λ t) = 0.05.
    assert none["per_hour_upper_95"] == pytest.approx(-math.log(0.05) / hours)


def test_a_missing_estimate_is_no_alarm() -> None:
    table = experiment(drive({2: {"single X": np.nan}})).alarms().set_index("watcher")
    assert table.loc["single frame, fixed limit", "alarms"] == 0


def test_error_is_that_of_the_last_window() -> None:
    moved: dict[str, object] = {"nominal X": -0.05, "before X": -0.05, "after X": -0.05}
    last: dict[str, object] = {
        "after X": -0.01,
        "after Yaw": math.radians(0.2),
        "mean X": -0.03,
        "single X": np.nan,
    }
    table = experiment(
        drive({8: moved | last, 9: moved | last | {"single X": -0.04}}, **STEP | moved)
    ).error()
    (row,) = table.to_dict("records")
    assert row["nothing_dof"] == pytest.approx(5.0)
    assert row["monitor_dof"] == pytest.approx(1.0)
    assert row["mean_dof"] == pytest.approx(2.0)
    assert row["single_dof"] == pytest.approx(1.0)
    assert row["monitor_cm"] == pytest.approx(1.0)
    assert row["monitor_deg"] == pytest.approx(0.2)
    assert row["nothing_deg"] == 0.0


def test_coverage_by_phase_counts_full_windows_only() -> None:
    out: dict[str, object] = {"inside Yaw": False, "joint": False}
    table = experiment(
        drive({}), drive({0: out, 1: out, 4: out, 5: out, 9: out}, **STEP)
    ).coverage().set_index(["kind", "phase"])  # fmt: skip
    assert table.loc[("still", "all"), "frames"] == 9
    assert table.loc[("still", "all"), "joint"] == 100.0
    assert table.loc[("step", "before"), "Yaw"] == pytest.approx(100 * 2 / 3)  # frames 1, 2, 3
    assert table.loc[("step", "before"), "X"] == 100.0
    assert table.loc[("step", "window holds both"), "Yaw"] == 0.0
    assert table.loc[("step", "after"), "joint"] == pytest.approx(75.0)


def test_an_update_is_harmful_if_the_whole_becomes_worse() -> None:
    good: dict[str, object] = {
        "updated": True,
        "before X": 0.05,
        "after X": 0.01,
        "after Yaw": 0.002,
    }
    bad: dict[str, object] = {"updated": True, "before X": 0.0, "after X": 0.03}
    table = experiment(
        drive({3: bad}), drive({5: good, 6: good}, **STEP)
    ).updates().set_index("kind")  # fmt: skip
    assert table.loc["step", "updates"] == 2
    assert table.loc["step", "harmful"] == 0
    assert table.loc["still", "harmful_share"] == 100.0
    # 3 of 10 cm in one of six DoF.
    assert table.loc["still", "largest_harm"] == pytest.approx(0.3 / math.sqrt(6))


def test_faults_are_flagged_only_once_they_are_there() -> None:
    flag: dict[str, object] = {"untrusted": True}
    fault = {"kind": "fault", "case": "black camera"}
    table = experiment(
        drive({n: flag for n in range(5, 10)}, **fault, drive="a"),
        drive({1: flag, 6: {"alarm": True, "updated": True, "after X": 0.1}}, **fault, drive="b"),
    ).faults()
    (row,) = table.to_dict("records")
    assert row["untrusted"] == pytest.approx(100 * 5 / 12)
    assert row["untrusted_before"] == pytest.approx(100 / 6)
    assert (row["flagged"], row["delay"]) == (50.0, 1.0)
    assert row["says_moved"] == pytest.approx(100 / 12)
    assert (row["updates"], row["harmful"]) == (1, 1)


def test_response_compares_a_street_with_itself() -> None:
    """A bias of the street is no response; the blind one has the bias alone."""
    rows = []
    for name, share in (("a", 1.0), ("b", 0.8)):
        for watcher, follows in (("monitor", share), ("blind", 0.0)):
            own: dict[str, object] = {"watcher": watcher, "drive": name, "mean X": 0.02}
            moved: dict[str, object] = {"nominal X": -0.05, "mean X": 0.02 - 0.05 * follows}
            rows += [drive({}, **own), drive({n: moved for n in range(4, 10)}, **STEP | own)]
    table = experiment(*rows).blind().set_index("watcher")
    assert table.loc["monitor", "response"] == pytest.approx(0.9)
    assert table.loc["blind", "response"] == pytest.approx(0.0)
    assert table.loc["blind", "drives"] == 2


def test_page_and_csv_of_an_experiment_that_has_only_begun(tmp_path: Path) -> None:
    tables = experiment(drive({})).tables()
    assert set(tables) == set(ABOUT) == set(TITLES)
    page = write_tables(tmp_path, tables, ["Simulated."], "python -m …")
    assert (tmp_path / "monitor.md").read_text(encoding="utf-8") == page
    assert "## False alarms" in page
    assert "## Faults of the stream" not in page
    assert {path.name for path in tmp_path.glob("*.csv")} == {f"monitor_{n}.csv" for n in tables}
    back = pd.read_csv(tmp_path / "monitor_alarms.csv")
    assert back["hours"].tolist() == tables["alarms"]["hours"].tolist()
