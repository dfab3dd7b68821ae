"""The findings as a table for people and as JSON for machines."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import asdict
from pathlib import Path

from uncal.checking.check import Checked
from uncal.checking.finding import KINDS

_WIDTH = 100
_LEGEND = "support: peak of the declared extrinsic over itself turned by 2° to 5°; 3 σ are enough"


def as_table(root: Path, checked: Checked) -> str:
    """Drives, then each fault with what was seen, what was expected and the remedy."""
    reports = checked.reports
    name = max([len("drive"), *(len(report.drive) for report in reports)])
    lines = [f"{root}: {checked.layout}, {len(reports)} drives", ""]
    lines.append(f"{'drive':{name}}  {'frames':>6}  {'support':>8}  result")
    for report in reports:
        support = "-" if math.isnan(report.support) else f"{report.support:.1f} σ"
        kinds = [f.kind if f.error else f"({f.kind})" for f in report.findings]
        result = ", ".join(dict.fromkeys(kinds)) or "ok"
        lines.append(f"{report.drive:{name}}  {report.n_frames:>6}  {support:>8}  {result}")
    lines += ["", _LEGEND]
    for finding in checked.findings:
        level = "error" if finding.error else "warning"
        lines += ["", f"{level}: {finding.kind} [{KINDS[finding.kind]}] in {finding.drive}"]
        for title, text in (
            ("seen", finding.seen),
            ("expected", finding.expected),
            ("remedy", finding.remedy),
        ):
            lines += textwrap.wrap(
                text, _WIDTH, initial_indent=f"  {title:<9} ", subsequent_indent=" " * 12
            )
    n_errors = sum(finding.error for finding in checked.findings)
    lines += ["", f"{n_errors} errors, {len(checked.findings) - n_errors} warnings"]
    if any(report.overlay for report in reports):
        folder = Path(next(report.overlay for report in reports if report.overlay)).parent
        lines.append(f"overlays: {folder}")
    return "\n".join(lines)


def as_json(root: Path, checked: Checked) -> str:
    """The same for machines; a support of null means that edges were not compared."""
    drives = []
    for report in checked.reports:
        content = asdict(report)
        content["support"] = None if math.isnan(report.support) else round(report.support, 2)
        drives.append(content)
    return json.dumps(
        {
            "root": str(root),
            "layout": checked.layout,
            "errors": sum(finding.error for finding in checked.findings),
            "drives": drives,
        },
        indent=2,
    )
