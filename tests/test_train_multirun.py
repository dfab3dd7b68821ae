"""A whole multirun, as a user starts it."""

from __future__ import annotations

import csv
import subprocess
from collections.abc import Callable
from pathlib import Path

from uncal.geometry import DOF_NAMES

Run = Callable[..., "subprocess.CompletedProcess[str]"]


def test_two_values_are_summarised_and_a_failed_one_is_named(
    start: Run, tiny: list[str], quick: list[str], make_workplace: Callable[[str], Path]
) -> None:
    place, swept = make_workplace("multirun"), "mcd.passes=2,0,3"
    words = ["-m", swept, *tiny, *quick, "hydra.sweep.dir=many"]
    finished = start("uncal.train", *words, cwd=place)
    assert finished.returncode == 1
    assert "mcd.passes=0: expected a whole number from 1" in finished.stderr
    assert "Traceback" not in finished.stderr

    with (place / "many" / "summary.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [(row["mcd.passes"], row["dof"]) for row in table] == [
        (passes, dof) for passes in ("2", "3") for dof in DOF_NAMES
    ]
    for passes, folder in (("2", "0"), ("3", "2")):
        with (place / "many" / folder / "results.csv").open(encoding="utf-8") as file:
            results = list(csv.DictReader(file))
        own = [row for row in table if row["mcd.passes"] == passes]
        assert [row["mpiw"] for row in own] == [row["mpiw"] for row in results]

    text = (place / "many" / "summary.md").read_text(encoding="utf-8")
    assert text.startswith("# Multirun on simulated street-scene data")
    assert f"python -m uncal.train -m {swept}" in text
    assert "- `1` (mcd.passes=0): mcd.passes=0: expected a whole number from 1" in text
