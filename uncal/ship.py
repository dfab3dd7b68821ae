"""Turn a run into weights that can be passed on: ``python -m uncal.ship RUN weights/NAME``."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError, UncalError
from uncal.weights.shipped import load_checkpoint, save_shipped

log = logging.getLogger(__name__)

LARGEST_BYTES = 10_000_000
"""Weights that ship are at most so large."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Read a run's folder, write ``NAME.safetensors`` and ``NAME.md``.

    Args:
        arguments: of the command line; None: the process's own.
    """
    parser = argparse.ArgumentParser(
        prog="python -m uncal.ship",
        description="Writes a run's weights, calibration and settings as NAME.safetensors, and a "
        "card NAME.md with the command, the settings and the results.",
    )
    parser.add_argument("run", type=Path, help="folder of a run of uncal.train or uncal.evaluate")
    parser.add_argument("target", type=Path, help="such as weights/unical")
    parser.add_argument("--training", default="", help="command that trained the weights")
    parser.add_argument("--commit", default="", help="commit of the training code")
    parser.add_argument("--limits", default="", help="what the weights cannot do")
    given = parser.parse_args(arguments)
    try:
        ship(given.run, given.target, given.training, given.commit, given.limits)
    except UncalError as error:
        raise SystemExit(str(error)) from error


def ship(run: Path, target: Path, training: str, commit: str, limits: str) -> None:
    """Write weights and card.

    Args:
        run: folder of the run.
        target: path without suffix.
        training: command that trained the weights; empty: the run's own.
        commit: of the training code; empty: the run's own.
        limits: what the weights cannot do.

    Raises:
        ConfigurationError: the folder is no finished run, or the weights are too large.
    """
    record = run / "run.json"
    if not record.is_file():
        raise ConfigurationError(f"{run}: no run.json; give the folder of a finished run")
    known = json.loads(record.read_text(encoding="utf-8"))
    state, recipe = load_checkpoint(run / "checkpoints" / "best.ckpt")
    path = target.with_suffix(".safetensors")
    plain = cast("dict[str, object]", OmegaConf.to_container(recipe, resolve=True))
    save_shipped(state, plain, path)
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        path.unlink()
        raise ConfigurationError(
            f"{path}: {size / 1e6:.1f} MB, more than {LARGEST_BYTES / 1e6:.0f}: use a smaller model"
        )
    card = _card(target.name, run, known, recipe, size, training, commit, limits)
    target.with_suffix(".md").write_text(card, encoding="utf-8")
    sys.stdout.write(f"{path} ({size / 1e6:.2f} MB)\n{target.with_suffix('.md')}\n")


def _card(
    name: str,
    run: Path,
    known: dict[str, object],
    recipe: DictConfig,
    size: int,
    training: str,
    commit: str,
    limits: str,
) -> str:
    table = (run / "results.md").read_text(encoding="utf-8").split("\n## ")[0]
    lines = [
        f"# Weights `{name}`",
        "",
        f"- File: `{name}.safetensors`, {size / 1e6:.2f} MB: weights, calibration, settings.",
        f"- Trained by: `{training or known.get('command')}`",
        f"- Commit of the training code: {commit or known.get('commit') or 'unknown'}",
        f"- Tested and calibrated by: `{known.get('command')}`",
        f"- Seed: {recipe.seed}; request digest {known.get('request')}",
        f"- Limits: {limits or 'not stated'}",
        "",
        table.replace("# Results", "## Results", 1).strip(),
        "",
        "Settings:",
        "",
        "```yaml",
        OmegaConf.to_yaml(
            OmegaConf.create({key: recipe[key] for key in ("model", "mcd", "split", "interval")})
        ).strip(),
        "```",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
