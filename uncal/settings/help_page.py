"""The page of ``--help``. For the same page Hydra composes and copies a configuration per group."""

from __future__ import annotations

import string
import sys
from pathlib import Path

import yaml  # type: ignore[import-untyped]

from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.sweep_source import GROUP, sweeps_folder


def show_help(source: str) -> None:
    """Print the page and end the process, if its arguments ask for it.

    Args:
        source: the file in ``conf/`` that has the page.
    """
    if {"--help", "-h"} & set(sys.argv[1:]):
        sys.stdout.write(page(Path(CONFIG_DIR) / source))
        raise SystemExit(0)


def page(source: Path) -> str:
    """The template ``help.template`` of Hydra's settings, filled in.

    Args:
        source: a file of the group hydra, or one with a key hydra.
    """
    content = yaml.safe_load(source.read_text(encoding="utf-8"))
    template = string.Template(content.get("hydra", content)["help"]["template"])
    groups = {**options(Path(CONFIG_DIR)), **options(sweeps_folder(), GROUP)}
    lines = [f"{group}: {', '.join(groups[group])}" for group in sorted(groups)]
    return template.substitute(APP_CONFIG_GROUPS="\n".join(lines) + "\n")


def options(folder: Path, prefix: str = "") -> dict[str, list[str]]:
    """The groups in a folder of configurations, Hydra's own left out.

    Args:
        folder: to look through.
        prefix: name of the folder as a group; empty if it is none.

    Returns:
        Group → its options.
    """
    found: dict[str, list[str]] = {}
    for path in sorted(folder.rglob("*.yaml")):
        parts = [*filter(None, [prefix]), *path.relative_to(folder).parent.parts]
        if parts and parts[0] != "hydra":
            found.setdefault("/".join(parts), []).append(path.stem)
    return found
