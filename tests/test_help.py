"""Help is a page, and costs no import of torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import pytest
import yaml  # type: ignore[import-untyped]

from uncal.__main__ import ENTRY_POINTS as LISTED
from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.help_page import show_help

ENTRY_POINTS = (
    *("train", "evaluate", "simulate", "benchmark", "report", "ship", "monitor", "check"),
    *("convert", "export", "calibrate"),
)
HEAVY = (
    *("torch", "lightning", "transformers", "matplotlib", "scipy", "cv2", "pandas", "numpy"),
    *("joblib", "submitit", "rosbags", "h5py", "uncal.runs.assembly", "uncal.settings.check"),
)


SHOWN = """
import runpy, sys
sys.argv = [sys.argv[1], "--help"]
try:
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
except SystemExit as stop:
    assert not stop.code, stop.code
print([name for name in {heavy} if name in sys.modules])
"""


@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_help_imports_nothing_that_only_a_run_needs(name: str) -> None:
    finished = subprocess.run(
        [sys.executable, "-c", SHOWN.format(heavy=HEAVY), f"uncal.{name}"],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    *page, imported = finished.stdout.splitlines()
    assert imported == "[]"
    assert any(f"python -m uncal.{name}" in line for line in page)


def test_the_page_lists_every_group_and_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    with patch.object(sys, "argv", ["train", "dataset=demo", "-h"]), pytest.raises(SystemExit):
        show_help("hydra/default.yaml")
    shown = capsys.readouterr().out
    for line in ("model/head: geometric, mlp, quantile", "split: paper"):
        assert f"\n{line}\n" in shown
    assert "\nsweeps: accuracy, " in shown
    assert "hydra:" not in shown
    with patch.object(sys, "argv", ["train", "--hydra-help"]):
        show_help("hydra/default.yaml")  # Hydra's own


@pytest.mark.parametrize(
    "name",
    [
        "hydra/default.yaml",
        "hydra/evaluate.yaml",
        "benchmark.yaml",
        "simulate.yaml",
        "monitor.yaml",
        "export.yaml",
        "calibrate.yaml",
        "convert.yaml",
    ],
)
def test_the_page_is_a_page(name: str) -> None:
    content = yaml.safe_load((Path(CONFIG_DIR) / name).read_text(encoding="utf-8"))
    text = content.get("hydra", content)["help"]["template"]
    assert "$CONFIG" not in text
    assert "--cfg job" in text
    assert len(text.splitlines()) <= 50
    assert max(map(len, text.splitlines())) <= 100


def test_the_package_itself_lists_what_can_be_started() -> None:
    root = Path(__file__).parents[1]
    started = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__main__")
        for path in (root / "uncal").rglob("*.py")
        if '\nif __name__ == "__main__":' in path.read_text(encoding="utf-8")
    }
    assert {f"uncal.{name}" for name in LISTED} == started - {"uncal"}
    for words, code in (((), 0), (("--help",), 0), (("train", "seed=1"), 2)):
        shown = subprocess.run(
            [sys.executable, "-m", "uncal", *words], cwd=root, capture_output=True, text=True
        )
        assert shown.returncode == code
        assert "python -m uncal.train " in shown.stdout
