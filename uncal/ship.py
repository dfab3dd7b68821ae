"""Turn a run into weights that can be passed on: ``python -m uncal.ship RUN weights/NAME``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from uncal.errors import ConfigurationError
from uncal.settings.configuration import exits_on_error

if TYPE_CHECKING:
    from omegaconf import DictConfig

LARGEST_BYTES = 10_000_000
"""Weights that ship are at most so large."""


@exits_on_error
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
    ship(given.run, given.target, given.training, given.commit, given.limits)


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
    # Here and not above: they take seconds, which --help has no use for.
    from omegaconf import OmegaConf

    from uncal.reporting.layout import replaced_whole, write_whole
    from uncal.reporting.run_record import read_record
    from uncal.system.disk import check_writable
    from uncal.weights.shipped import load_checkpoint, save_shipped

    known, table = read_record(run), run / "results.md"
    if known is None or not table.is_file():
        lacking = "run.json" if known is None else table.name
        raise ConfigurationError(
            f"{run}: no {lacking} that can be read; give the folder of one finished run of "
            "uncal.train or uncal.evaluate (of a multirun: of one of its jobs)"
        )
    stem = target.name.removesuffix(".safetensors")
    if not stem.strip("."):
        raise ConfigurationError(f"target {str(target)!r}: expected a name, such as weights/unical")
    path, card = target.with_name(f"{stem}.safetensors"), target.with_name(f"{stem}.md")
    state, recipe = load_checkpoint(run / "checkpoints" / "best.ckpt")
    plain = cast("dict[str, object]", OmegaConf.to_container(recipe, resolve=True))
    try:
        check_writable(path)
        with replaced_whole(path) as partial:
            save_shipped(state, plain, partial)
            size = partial.stat().st_size
            if size > LARGEST_BYTES:
                raise ConfigurationError(
                    f"{path}: {size / 1e6:.1f} MB, more than {LARGEST_BYTES / 1e6:.0f}: use a "
                    "smaller model"
                )
        text = table.read_text(encoding="utf-8").split("\n## ")[0]
        write_whole(card, _card(stem, text, known, recipe, size, training, commit, limits))
    except OSError as error:
        raise ConfigurationError(f"{target}: cannot be written ({error.strerror})") from error
    sys.stdout.write(f"{path} ({size / 1e6:.2f} MB)\n{card}\n")


def _card(
    name: str,
    table: str,
    known: Mapping[str, object],
    recipe: DictConfig,
    size: int,
    training: str,
    commit: str,
    limits: str,
) -> str:
    from omegaconf import OmegaConf

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
