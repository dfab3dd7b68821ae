"""The page as a browser lays it out; skipped where there is no Chromium."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from uncal.report import main

MakeRun = Callable[..., Path]
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)

# The page at both widths, then Table 1 sorted by its third column, upwards and downwards.
HOST = """<!DOCTYPE html><body>
<iframe src="report.html" width="1280" height="900"></iframe>
<iframe src="report.html" width="400" height="900"></iframe>
<pre id="found"></pre>
<script>
addEventListener("load", () => {
  const pages = [...document.querySelectorAll("iframe")].map(frame => frame.contentDocument);
  const [table] = [...pages[0].querySelectorAll("table")].filter(t => t.tHead.rows.length == 2);
  const heading = table.tHead.rows[1].cells[2];
  const column = () => [...table.tBodies].map(body => body.rows[0].cells[2].textContent);
  const sorted = [0, 1].map(() => { heading.click(); return column(); });
  const roots = pages.map(page => page.documentElement);
  const widths = roots.map(root => [root.scrollWidth, root.clientWidth]);
  const pictures = [...pages[1].images].map(image => [image.naturalWidth, image.width]);
  const found = JSON.stringify({widths, sorted, pictures});
  document.getElementById("found").textContent = found;
});
</script></body>"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, make: MakeRun) -> dict[str, Any]:
    if BROWSER is None:
        pytest.skip("no Chromium on this machine")
    root = tmp_path_factory.mktemp("browser")
    runs = [make(root / "conformal"), make(root / "alone", gaussian=True)]
    main([*map(str, runs), "--output", str(root / "report")])
    (root / "report" / "host.html").write_text(HOST, encoding="utf-8")
    command = [
        *(BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"),
        *(f"--user-data-dir={root / 'profile'}", "--virtual-time-budget=20000", "--dump-dom"),
        (root / "report" / "host.html").as_uri(),
    ]
    page = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    content = re.search(r'<pre id="found">(.*?)</pre>', page, re.DOTALL)
    assert content is not None
    answer: dict[str, Any] = json.loads(unescape(content[1]))
    return answer


def test_nothing_overflows_on_a_screen_or_a_phone(found: dict[str, Any]) -> None:
    (wide, wide_room), (narrow, narrow_room) = found["widths"]
    assert wide <= wide_room
    assert narrow <= narrow_room
    assert narrow_room <= 400


def test_figures_are_inline_and_fit(found: dict[str, Any]) -> None:
    assert len(found["pictures"]) == 8
    assert all(natural > 0 and shown <= 400 for natural, shown in found["pictures"])


def test_a_click_sorts_the_sources_and_another_turns_them_round(found: dict[str, Any]) -> None:
    upwards, downwards = ([float(cell.rstrip("*")) for cell in cells] for cells in found["sorted"])
    assert upwards == sorted(upwards)
    assert downwards == sorted(upwards, reverse=True)
