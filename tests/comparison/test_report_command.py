"""``python -m uncal.report`` on folders with everything, with little, and with nothing."""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from uncal.geometry import DOF_NAMES
from uncal.multirun.summary import write_summary
from uncal.report import main
from uncal.reporting.figures.style import NamedFigure, save
from uncal.reporting.published.paper import published_paper

MakeRun = Callable[..., Path]
HOSTILE = 'KITTI <script>alert("&")</script>'


class Page(HTMLParser):
    """Tables by heading, their row headings spread over the rows; tags, attributes and text."""

    VOID = ("meta", "img", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.heading = ""
        self.tables: dict[str, list[list[str]]] = {}
        self._cell = ""
        self._left, self._name = 0, ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = dict(attrs)
        self.tags.append((tag, said))
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "h3":
            self.heading = ""
        elif tag == "tr":
            self._row: list[str] = []
            if self._left:
                self._row.append(self._name)
                self._left -= 1
        elif tag in ("th", "td"):
            self._cell = ""
            self._rows = int(said.get("rowspan") or 0)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag in ("th", "td"):
            self._row.append(self._cell)
            if self._rows:
                self._left, self._name = self._rows - 1, self._cell
        elif tag == "tr":
            self.tables.setdefault(self.heading, []).append(self._row)

    def handle_data(self, data: str) -> None:
        self.text += data
        self._cell += data
        if self.open and self.open[-1] == "h3":
            self.heading += data

    def rows(self, heading: str, source: str) -> list[list[str]]:
        """The rows of one source in the table whose heading has these words."""
        (name,) = [title for title in self.tables if heading in title]
        return [row for row in self.tables[name] if row[0].startswith(source)]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, make: MakeRun) -> list[Path]:
    """A conformal run with figures, MC dropout alone with hostile words, a bare run."""
    root = tmp_path_factory.mktemp("runs")
    runs = [
        make(root / "conformal"),
        make(root / "alone", gaussian=True, label=HOSTILE),
        make(root / "bare", seed=5, bare=True),
    ]
    for run in runs[:2]:
        figure = NamedFigure("curve", "Calibration <curve>", "How to read it.", Figure((2, 1)))
        save(figure, run / "figures")
    return runs


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, folders: list[Path]) -> Path:
    output = tmp_path_factory.mktemp("report") / "new" / "folder"
    main([*map(str, folders), "--output", str(output)])
    return output


@pytest.fixture(scope="module")
def page(written: Path) -> Page:
    return Page((written / "report.html").read_text(encoding="utf-8"))


def test_the_page_needs_nothing_else(written: Path, page: Page) -> None:
    names = {tag for tag, _ in page.tags}
    assert not names & {"link", "iframe", "object", "embed", "base", "form"}
    pointing = [said[key] or "" for _, said in page.tags for key in ("src", "href") if key in said]
    assert all(each.startswith(("data:image/png;base64,", "#part-")) for each in pointing)
    assert not any(key.startswith("on") for _, said in page.tags for key in said)
    assert [said for tag, said in page.tags if tag == "script"] == [{}]  # its own, to sort
    text = (written / "report.html").read_text(encoding="utf-8")
    assert "url(" not in text
    assert "@import" not in text
    anchors = {said.get("id") for tag, said in page.tags if tag == "section"}
    assert {each[1:] for each in pointing if each.startswith("#")} == anchors


def test_words_of_others_stay_words(written: Path, page: Page) -> None:
    assert HOSTILE in page.text
    assert (written / "report.html").read_text(encoding="utf-8").count("<script") == 1
    assert "Calibration <curve>" in page.text


def test_the_notice_names_whose_numbers_are_whose(written: Path, page: Page) -> None:
    for text in (page.text, (written / "report.md").read_text(encoding="utf-8")):
        assert "The paper measured on real KITTI and DSEC, each run on its own data" in text
        assert "not comparable as accuracy" in text
        assert f"Run 1: simulated street-scene; Run 2: {HOSTILE}" in text


def test_table_1_has_the_paper_beside_the_runs(page: Page, folders: list[Path]) -> None:
    title = "the paper's Table 1"
    (kitti, *_) = page.rows(title, "Paper, Table 1: real KITTI")
    assert kitti[1:5] == ["PICP (%)", "89.4", "95.3", "98.8"]
    dsec = page.rows(title, "Paper, Table 1: real DSEC")
    assert [row[1] for row in dsec] == ["PICP (%)", "MPIW", "IS"]
    assert dsec[2][-3:] == ["0.16", "0.19", "0.27"]
    with (folders[0] / "results.csv").open(encoding="utf-8") as file:
        results = {(row["dof"], row["level"]): row for row in csv.DictReader(file)}
    picp, mpiw, score = page.rows(title, "Run 1: simulated street-scene; MC dropout + conformal")
    cells = [(dof, level) for dof in DOF_NAMES for level in ("90.0", "95.0", "99.0")]
    for j, key in enumerate(cells):
        row = results[key]
        digits = 2 if row["unit"] == "cm" else 3
        assert picp[2 + j].rstrip("*") == f"{float(row['picp']):.1f}"
        assert picp[2 + j].endswith("*") == (row["in_band"] == "False")
        assert mpiw[2 + j] == f"{float(row['mpiw']):.{digits}f}"
        assert score[2 + j] == f"{float(row['is']):.{digits}f}"
    assert len(page.rows(title, "Run 3: data not recorded; interval method not")) == 3


def test_table_2_has_only_runs_of_dropout_alone(page: Page) -> None:
    title = "the paper's Table 2"
    paper = page.rows(title, "Paper, Table 2: real KITTI")
    assert paper[0][1:] == ["90%", "77.3", "90.3", "76.9", "79.69", "85.0", "80.6"]
    alone = page.rows(title, "Run 2")
    assert [row[1] for row in alone] == ["90%", "95%", "99%"]
    # σ is half of what it should be: ±1.645 σ holds 59 % of a normal error.
    assert all(35 < float(cell) < 80 for cell in alone[0][2:])
    assert not page.rows(title, "Run 1")


def test_errors_and_what_the_paper_does_not_report(page: Page) -> None:
    paper = page.rows("Errors of the estimate", "Paper, section 4.4: real KITTI")
    assert [row[-2:] for row in paper] == [["0.46", "0.04"], ["0.33-0.89", "0.03-0.04"]]
    own = page.rows("Errors of the estimate", "Run 1")
    assert [row[1] for row in own] == [
        "before (the decalibration)",
        "after, mean of the passes",
        "after, one pass without dropout",
        "after, length and angle",
    ]
    assert own[1][2:] == own[2][2:]  # made so
    assert len(page.rows("Errors of the estimate", "Run 3")) == 2
    control = {row[1]: row[2:] for row in page.rows("image-blind control", "Run 1")}
    errors = [float(cell) for cell in control["MAE after, one pass without dropout"]]
    blind = [float(cell) for cell in control["the same, another frame's image"]]
    assert blind == pytest.approx([3 * each for each in errors], rel=0.02)
    together = page.rows("The whole pose", "Run 1")[0]
    assert together[1] == "All six intervals at once (%)"
    assert float(together[2]) < 90
    assert "Not shown, since without control.csv: Run 3." in page.text
    assert len(page.rows("by size of the decalibration", "Run 3")) == 6
    assert page.rows("Calibration curve", "Run 2")


def test_every_number_says_who_made_it(page: Page) -> None:
    made = "Run 1: python -m uncal.train seed=0 · seed 0 · commit abc1234"
    assert page.text.count(made) == 8  # seven tables, one figure
    assert "Run 3: command not recorded (no run.json" in page.text
    assert "0123456789abcdef: reused, trained earlier (400 s)" in page.text
    assert "0123456789abcdef: trained in this run (400 s); test passes computed" in page.text
    assert "no predictions.csv, hence without the error of the whole pose" in page.text
    assert "WACV 2025, Table 1" in page.text
    assert published_paper().doubts[0] in page.text


def test_figures_of_the_folder_or_drawn_from_its_tables(page: Page, folders: list[Path]) -> None:
    images = [said for tag, said in page.tags if tag == "img"]
    stored = (folders[0] / "figures" / "curve.png").read_bytes()
    data = [base64.b64decode((said["src"] or "").partition(",")[2]) for said in images]
    assert data[0] == stored
    assert images[0]["alt"] == "Calibration <curve>"
    assert images[0]["style"] == "width: 2.00in"
    assert len(images) == 4  # the bare run's tables allow its calibration curves and joint coverage
    assert all(each.startswith(b"\x89PNG") for each in data)
    assert "How to read it." in page.text


def test_the_csv_has_a_number_per_line(written: Path, folders: list[Path]) -> None:
    with (written / "report.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert list(table[0]) == [
        *("source", "data", "method", "dof", "unit", "level", "metric", "value"),
    ]
    paper = [row for row in table if row["source"].startswith("paper, Table")]
    assert len(paper) == 120
    roll = [row["value"] for row in paper if row["source"] == "paper, Table 2"]
    assert roll[3] == "79.69"
    own = [row for row in table if row["source"] == str(folders[0])]
    assert {row["data"] for row in own} == {"simulated street-scene"}
    found = {(row["dof"], row["level"], row["metric"]): row for row in own}
    assert len(found) == len(own)
    with (folders[0] / "results.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            for metric in ("picp", "mpiw", "is"):
                cell = found[(row["dof"], row["level"], metric)]
                assert cell["value"] == row[metric]
                assert cell["unit"] == ("%" if metric == "picp" else row["unit"])
    assert found[("all", "90.0", "together")]["unit"] == "%"
    assert float(found[("all", "", "translation_after")]["value"]) > 0
    assert found[("X", "", "contribution")]["unit"] == "%"


def test_the_markdown_has_the_same_tables(written: Path, page: Page) -> None:
    text = (written / "report.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^### (.*)$", text, re.MULTILINE)) == set(page.tables) - {
        "Calibration <curve>"
    }
    lines = text.splitlines()
    first = next(line for line in lines if line.startswith("| source | metric |"))
    assert "X (cm) 90%" in first
    kitti = next(line for line in lines if line.startswith("| Paper, Table 1: real KITTI"))
    assert [cell.strip() for cell in kitti.split("|")[2:5]] == ["PICP (%)", "89.4", "95.3"]


def test_the_terminal_and_the_default_folder(
    tmp_path: Path,
    folders: list[Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    main([str(folders[0])])
    lines = capsys.readouterr().out.splitlines()
    assert "not comparable as accuracy" in lines[0]
    (run,) = [line for line in lines if line.startswith("Run 1: simulated street-scene")]
    assert re.search(r"\d+\.\d-\d+\.\d +\d+\.\d\d cm +\d\.\d{3}°$", run)
    (paper,) = [line for line in lines if line.startswith("Paper, Table 1, real KITTI")]
    assert paper.split()[-4:] == ["88.7-90.5", "2.29", "cm", "0.200°"]
    assert re.fullmatch(r"outputs/report/[-\d_]+/report\.html", lines[-1])
    assert Path(lines[-1]).is_file()
    assert "None of the runs has these intervals" in Path(lines[-1]).read_text(encoding="utf-8")


def test_a_multirun_shows_its_summary_and_its_jobs(tmp_path: Path, make: MakeRun) -> None:
    many = tmp_path / "many"
    for number in (0, 1):
        job = make(many / str(number), seed=number)
        (job / ".hydra").mkdir()
        (job / ".hydra" / "overrides.yaml").write_text(f"- mcd.passes={5 + number}\n")
    command = "python -m uncal.train -m mcd.passes=5,6"
    write_summary(many, command)
    save(NamedFigure("score", "Score", "Lower is better.", Figure((2, 1))), many / "figures")
    main([str(many), "--output", str(tmp_path / "report")])
    page = Page((tmp_path / "report" / "report.html").read_text(encoding="utf-8"))
    title = "the paper's Table 1"
    assert len(page.rows(title, "Run 1, job 0 (mcd.passes=5): simulated street-scene")) == 3
    assert len(page.rows(title, "Run 1, job 1 (mcd.passes=6): simulated street-scene")) == 3
    assert [row[0] for row in page.tables["90% intervals"]] == ["mcd.passes", "5", "6"]
    assert page.text.count(f"Run 1: {command} · seed 0, 1 · commit abc1234 · simulated") > 1
    assert [said["alt"] for tag, said in page.tags if tag == "img"] == ["Score"]


def test_what_a_multirun_lacks_stands_on_the_page(tmp_path: Path, make: MakeRun) -> None:
    many = tmp_path / "many"
    job = make(many / "0")
    for folder, passes in ((job, 5), (many / "1", 6)):
        (folder / ".hydra").mkdir(parents=True)
        (folder / ".hydra" / "overrides.yaml").write_text(f"- mcd.passes={passes}\n")
    (many / "1" / "failed.txt").write_text("no memory\n")

    def page() -> Page:
        main([str(many), "--output", str(tmp_path / "report")])
        return Page((tmp_path / "report" / "report.html").read_text(encoding="utf-8"))

    assert "Run 1: command not recorded (no multirun.json) · seed 0" in page().text
    planned = [{"mcd.passes": passes} for passes in ("5", "6", "7")]
    write_summary(many, "python -m uncal.train -m mcd.passes=5,6,7", planned)
    text = page().text
    assert "Jobs: 3, with results: 1." in text
    assert "If it is no longer running, this command resumes it:" in text
    assert f"python -m uncal.train -m mcd.passes=5,6,7 hydra.sweep.dir={many}" in text
    assert "1 (mcd.passes=6): no memory" in text
    assert "not started (mcd.passes=7)" in text
    assert "`" not in text
    (many / "multirun.json").write_text("{")
    assert "command not recorded" in page().text


def test_errors_end_with_their_message(tmp_path: Path, folders: list[Path]) -> None:
    for arguments, words in (
        ([str(tmp_path / "nowhere")], "there is no such folder"),
        ([str(tmp_path)], "no results.csv"),
        ([str(folders[0]), "--output", str(folders[0] / "results.csv")], "cannot be written"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert words in str(caught.value.code)
        assert arguments[-1] in str(caught.value.code)


def test_where_to_write_is_tried_before_the_work(
    folders: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def works(*_: object) -> None:
        raise AssertionError("compared before the folder was tried")

    monkeypatch.setattr("uncal.comparison.page.compare", works)
    with pytest.raises(SystemExit, match="cannot be written"):
        main([str(folders[0]), "--output", str(folders[0] / "results.csv" / "x")])


def test_a_damaged_figure_is_named(tmp_path: Path, make: MakeRun) -> None:
    run = make(tmp_path / "run")
    (run / "figures").mkdir()
    (run / "figures" / "curve.png").write_bytes(b"\x89PNG no")
    with pytest.raises(SystemExit, match=r"curve\.png is no readable PNG"):
        main([str(run), "--output", str(tmp_path / "report")])


def test_help_shows_how(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "python -m uncal.report outputs/demo/" in text
    assert "report.html" in text
    assert "--output FOLDER" in text
