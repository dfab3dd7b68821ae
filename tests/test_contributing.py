"""The pages on how to extend uncal: their files are written, their code and commands run."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., "subprocess.CompletedProcess[str]"]

ROOT = Path(__file__).parents[1]
PAGES = {
    "dataset": ["trainer.accelerator=cpu", "model.search.samples=64"],
    "network": ["trainer.max_epochs=1", "mcd.passes=2"],
    "interval_method": [],
    "experiment": ["trainer.max_epochs=2"],
}
"""Page → what makes its commands quick."""
NO_PICTURES = {
    "uncal.train": [
        f"callbacks.{name}=null" for name in ("figures", "overlays", "interval_overlays")
    ],
    "uncal.evaluate": [f"callbacks.{name}=null" for name in ("figures", "interval_overlays")],
}
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)


def test_contributing_names_every_page() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    linked = re.findall(r"\(docs/extend/(\w+)\.md\)", text)
    assert linked == list(PAGES)
    assert sorted(path.stem for path in (ROOT / "docs" / "extend").glob("*.md")) == sorted(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_works_as_it_stands(
    page: str,
    demo: object,
    workplace: Path,
    start: Run,
    tiny: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(workplace)
    monkeypatch.syspath_prepend(str(workplace))
    text = (ROOT / "docs" / "extend" / f"{page}.md").read_text(encoding="utf-8")
    blocks = BLOCK.findall(text)
    assert {kind for kind, _, _ in blocks} == {"yaml", "sh", "python"}
    names: dict[str, object] = {}
    for kind, title, content in blocks:
        if title:
            Path(title).parent.mkdir(parents=True, exist_ok=True)
            Path(title).write_text(content, encoding="utf-8")
        elif kind == "python":
            exec(compile(content, f"{page}.md", "exec"), names)
        elif kind == "sh":
            for line in content.splitlines():
                python, m, module, *words = shlex.split(line)
                assert (python, m) == ("python", "-m")
                made = [] if page in ("dataset", "interval_method") else tiny
                quiet = [*NO_PICTURES[module], *PAGES[page], *made]
                finished = start(module, *words, *quiet, cwd=workplace)
                assert finished.returncode == 0, finished.stderr[-4000:]
                assert "X" in finished.stdout
