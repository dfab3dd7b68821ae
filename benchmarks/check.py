"""What `uncal.check` finds in good recordings that were broken, and in the good ones.

    python benchmarks/check.py OUT kitti=FOLDER… dsec=FOLDER… [name=FOLDER…]

Copies each folder, breaks the copy in one way (:mod:`breaking_kitti`, :mod:`breaking_dsec`), checks
it, and notes for each drive which kinds were named as errors: the right one (found), another one
(falsely found). A folder is read as DSEC's where it holds ``data``, else as KITTI raw. Writes
OUT.csv and OUT.md.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import pandas as pd

from breaking import Break
from breaking_dsec import dsec_faults
from breaking_kitti import kitti_faults
from uncal.checking.check import check

MARK = "<!-- Above: written by benchmarks/check.py. -->"


def main(out: Path, sources: dict[str, Path]) -> None:
    """Break, check, count; what OUT.csv has already is not repeated."""
    path = out.with_suffix(".csv")
    rows = pd.read_csv(path, keep_default_na=False).to_dict("records") if path.is_file() else []
    for name, source in sources.items():
        faults: dict[str, tuple[str, Break]] = {"none": ("", lambda _: None)}
        faults |= dsec_faults() if (source / "data").is_dir() else kitti_faults()
        for fault, (kind, put_in) in faults.items():
            if any(row["recordings"] == name and row["fault"] == fault for row in rows):
                continue
            with tempfile.TemporaryDirectory() as folder:
                root = Path(folder) / "root"
                shutil.copytree(source, root)
                put_in(root)
                checked = check(root, None, 8, None, quiet=True)
            for report in checked.reports:
                named = {finding.kind for finding in report.findings if finding.error}
                rows.append(
                    {
                        "recordings": name,
                        "drive": report.drive,
                        "fault": fault,
                        "kind": kind,
                        "found": kind in named,
                        "falsely": ", ".join(sorted(named - {kind})),
                        "support": round(report.support, 1),
                    }
                )
            table = pd.DataFrame(rows)
            table.to_csv(path, index=False)
            write_page(out.with_suffix(".md"), table)
            sys.stdout.write(f"{name}: {fault}\n")
            sys.stdout.flush()


def write_page(path: Path, table: pd.DataFrame) -> None:
    """Write the table; what stands below :data:`MARK` in the page stays."""
    known = path.read_text(encoding="utf-8") if path.is_file() else ""
    text = known.partition(MARK)[2] or "\n"
    path.write_text(_page(table) + MARK + text, encoding="utf-8")


def _page(table: pd.DataFrame) -> str:
    names = list(table.recordings.unique())
    lines = [
        "# Faults that `python -m uncal.check` finds",
        "",
        "Drives in which the fault was named / drives broken (of good ones: passed / checked), and "
        "drives in which another",
        "fault was named as an error. Each drive was broken in one way; 8 frames of each were "
        "compared. A dash: the layout cannot",
        "have this fault. `python benchmarks/check.py docs/results/check NAME=FOLDER …` goes on "
        "where the CSV ends.",
        "",
        "| fault | word | " + " | ".join(names) + " | falsely found |",
        "|---|---|" + "---|" * (len(names) + 1),
    ]
    order = ["none", *kitti_faults()]
    for fault in sorted(table.fault.unique(), key=order.index):
        part = table[table.fault == fault]
        cells = []
        for name in names:
            here = part[part.recordings == name]
            good = here.found.sum() if fault != "none" else (here.falsely == "").sum()
            cells.append(f"{good}/{len(here)}" if len(here) else "-")
        false = part[part.falsely != ""]
        wrong = ", ".join(f"{n} × {kinds}" for kinds, n in false.falsely.value_counts().items())
        word = part.kind.iloc[0] or "no error"
        lines.append(f"| {fault} | `{word}` | " + " | ".join(cells) + f" | {wrong or '-'} |")
    return "\n".join([*lines, "", ""])


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[2:])
    main(Path(sys.argv[1]), {name: Path(folder) for name, folder in given.items()})
