"""The page of ``--help``. For the same page Hydra composes and copies a configuration per group."""

from __future__ import annotations

import string
import sys
from pathlib import Path

import yaml  # type: ignore[import-untyped]

from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.sweep_source import GROUP, sweeps_folder


def show_help(source: str) -> None:
    """Print the page of a file in ``conf/`` and end the process, if its arguments ask for it."""
    if {"--help", "-h"} & set(sys.argv[1:]):
        sys.stdout.write(page(Path(CONFIG_DIR) / source))
        raise SystemExit(0)


def page(source: Path) -> str:
    """The template ``help.template`` of Hydra's settings in a file, filled in."""
    content = yaml.safe_load(source.read_text(encoding="utf-8"))
    template = string.Template(content.get("hydra", content)["help"]["template"])
    groups = {**options(Path(CONFIG_DIR)), **options(sweeps_folder(), GROUP)}
    lines = [f"{group}: {', '.join(groups[group])}" for group in sorted(groups)]
    return template.substitute(APP_CONFIG_GROUPS="\n".join(lines) + "\n")


def options(folder: Path, prefix: str = "") -> dict[str, list[str]]:
    """Group → options of a folder, Hydra's own left out; ``prefix`` is its group."""
    found: dict[str, list[str]] = {}
    for path in sorted(folder.rglob("*.yaml")):
        parts = [*filter(None, [prefix]), *path.relative_to(folder).parent.parts]
        if parts and parts[0] != "hydra":
            found.setdefault("/".join(parts), []).append(path.stem)
    return found
