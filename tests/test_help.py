"""Help is a page, and costs no import of torch."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest
import yaml  # type: ignore[import-untyped]

from uncal.configuration import CONFIG_DIR

ENTRY_POINTS = ("train", "evaluate", "simulate", "benchmark", "report", "export", "calibrate")
HEAVY = ("torch", "lightning", "transformers", "matplotlib", "scipy", "cv2", "pandas")


def test_entry_points_import_nothing_heavy_before_they_run() -> None:
    names = ", ".join(f"uncal.{name}" for name in ENTRY_POINTS)
    code = f"import sys, {names}; print([name for name in {HEAVY} if name in sys.modules])"
    finished = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert finished.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "name",
    [
        *("hydra/default.yaml", "hydra/evaluate.yaml", "benchmark.yaml", "simulate.yaml"),
        *("export.yaml", "calibrate.yaml"),
    ],
)
def test_the_page_is_a_page(name: str) -> None:
    content = yaml.safe_load((Path(CONFIG_DIR) / name).read_text(encoding="utf-8"))
    text = content.get("hydra", content)["help"]["template"]
    assert "$CONFIG" not in text
    assert "--cfg job" in text
    assert len(text.splitlines()) <= 50
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.slow
def test_help_costs_little_more_than_hydra_itself() -> None:
    """Processor time, which a busy machine does not stretch."""
    hydra = processor_seconds("-c", "import hydra")
    shown = processor_seconds("-m", "uncal.train", "--help")
    assert shown - hydra < 1.2


def processor_seconds(*arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments],
        cwd=Path(__file__).parents[1],
        stdout=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
