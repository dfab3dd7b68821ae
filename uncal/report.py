"""Runs next to the paper's Table 1 and Table 2: ``python -m uncal.report RUN…``."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from uncal.errors import UncalError
from uncal.settings.configuration import exits_on_error, quiet_libraries

DESCRIPTION = """\
Shows one or several runs next to the paper's Table 1 and Table 2 (WACV 2025): intervals, MC dropout
alone, errors, the whole pose, the image-blind control, coverage by σ, and the figures, each with
the command it came from. The paper measured on real KITTI and DSEC, a run on its own data: compare
coverage with its nominal level, not one accuracy with another; the page says so."""

EPILOG = """\
Written into the output folder:
  report.html  everything, in one page that can be mailed or printed; needs no network
  report.md    the same tables as text
  report.csv   one number per line: source, data, method, dof, unit, level, metric, value

Examples:
  python -m uncal.report outputs/demo/2025-01-31_12-00-00-000000
  python -m uncal.report outputs/demo/A outputs/demo/B --output comparison
  python -m uncal.report outputs/multirun/2025-01-31_13-00-00-000000

A run's folder is what python -m uncal.train and uncal.evaluate name at their end. The page names
the files that a folder lacks. For the paper's Table 2 give a run with interval=gaussian."""


@exits_on_error
def main(arguments: Sequence[str] | None = None) -> None:
    """Read, compare, write, show."""
    options = parser().parse_args(arguments)
    # Here and not above: they take seconds, which --help has no use for.
    from uncal.comparison.gathering import gather
    from uncal.comparison.page import compare, html_page, markdown_text, terminal_text
    from uncal.comparison.tidy import tidy_csv
    from uncal.reporting.layout import write_whole
    from uncal.reporting.published.paper import published_paper
    from uncal.system.disk import check_writable

    quiet_libraries()
    gathered, paper = gather(options.runs), published_paper()
    given = sys.argv[1:] if arguments is None else arguments
    folder = options.output or Path("outputs/report") / f"{datetime.now():%Y-%m-%d_%H-%M-%S-%f}"
    try:
        check_writable(folder / "report.html")
        content = compare(paper, gathered, shlex.join(["python", "-m", "uncal.report", *given]))
        page = write_whole(folder / "report.html", html_page(content))
        write_whole(folder / "report.md", markdown_text(content))
        write_whole(folder / "report.csv", tidy_csv(paper, gathered.all_runs))
    except OSError as error:
        raise UncalError(
            f"--output {folder}: the report cannot be written there ({error.strerror}); give a "
            "folder that can be written to"
        ) from error
    sys.stdout.write(f"{terminal_text(paper, gathered)}\n\n{page}\n")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command_line = argparse.ArgumentParser(
        prog="python -m uncal.report",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command_line.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="folder of a run or of a multirun"
    )
    command_line.add_argument(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="where to write (default: outputs/report/<time>)",
    )
    return command_line


if __name__ == "__main__":
    main()
