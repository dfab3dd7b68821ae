from __future__ import annotations

import logging
from pathlib import Path

import cv2
import matplotlib as mpl
import pytest

from uncal.geometry import DOF_NAMES
from uncal.reporting.figures.style import (
    DOF_COLOURS,
    DOF_LINES,
    DOF_MARKERS,
    PNG_DPI,
    SINGLE_COLUMN,
    NamedFigure,
    new_figure,
    paper_style,
    save,
    shared_legend,
)


def _figure() -> NamedFigure:
    with paper_style():
        figure, (panel,) = new_figure(1, 1, width=SINGLE_COLUMN, height=2.0, label="simulated")
        panel.plot([0, 1], [0, 1])
        panel.set_xlabel("Passes")
    return NamedFigure("some_name", "A title", "How to read it.", figure)


def _settings() -> dict[str, object]:
    # Without "backend": to ask for it is to choose it.
    return {key: mpl.rcParams[key] for key in mpl.rcParams if key != "backend"}


def test_png_and_pdf_of_the_size_asked_for_and_nothing_else(tmp_path: Path) -> None:
    png, pdf = save(_figure(), tmp_path / "run" / "figures")
    assert sorted(path.name for path in png.parent.iterdir()) == ["some_name.pdf", "some_name.png"]
    picture = cv2.imread(str(png))
    assert picture is not None
    assert picture.shape == (2.0 * PNG_DPI, SINGLE_COLUMN * PNG_DPI, 3)
    assert pdf.read_bytes().startswith(b"%PDF")
    assert b"/Type3" not in pdf.read_bytes()


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    first, again = (save(_figure(), tmp_path / name) for name in ("a", "b"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]


def test_a_figure_that_cannot_be_drawn_leaves_the_file_of_before(tmp_path: Path) -> None:
    png, _ = save(_figure(), tmp_path)
    before = png.read_bytes()
    broken = _figure()
    broken.figure.axes[0].set_title("$\\nonsense$")
    with pytest.raises(ValueError, match="nonsense"):
        save(broken, tmp_path)
    assert png.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 2


def test_no_setting_of_the_user_is_changed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before, level = _settings(), logging.getLogger("fontTools").level
    with caplog.at_level(logging.INFO):
        save(_figure(), tmp_path)
    assert _settings() == before
    assert logging.getLogger("fontTools").level == level
    assert caplog.records == []


def test_colour_is_never_the_only_cue() -> None:
    assert len({DOF_COLOURS[dof] for dof in DOF_NAMES}) == 6
    assert len({DOF_MARKERS[dof] for dof in DOF_NAMES}) == 6
    assert len({DOF_LINES[dof] for dof in DOF_NAMES[:3]}) == 3


def test_the_shared_legend_names_everything_once() -> None:
    with paper_style():
        figure, panels = new_figure(1, 2, height=2.0, label="simulated")
        panels[0].plot([0, 1], label="a")
        panels[1].plot([0, 1], label="a")
        panels[1].plot([0, 1], label="b")
        legend = shared_legend(figure, panels)
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b"]
