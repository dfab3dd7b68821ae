"""Weights to be passed on: whole, small enough, and never instead of better ones by accident."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import patch

import pytest
import torch

from uncal.ship import main
from uncal.weights.shipped import load_shipped

RECIPE = {"seed": 3, "model": {"name": "m"}, "mcd": {}, "split": {}, "interval": {}}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    content = {"state_dict": {"weight": torch.ones(3)}, "uncal_recipe": RECIPE}
    torch.save(content, folder / "checkpoints" / "best.ckpt")
    (folder / "run.json").write_text(json.dumps({"command": "python -m uncal.train"}))
    (folder / "results.md").write_text("# Results\n\na table\n\n## More\n")
    return folder


@pytest.mark.parametrize("target", ["new/net.v2", "new/net.v2.safetensors"])
def test_weights_and_card_lie_beside_each_other(run: Path, tmp_path: Path, target: str) -> None:
    main([str(run), str(tmp_path / target)])
    state, recipe = load_shipped(tmp_path / "new" / "net.v2.safetensors")
    assert state["weight"].tolist() == [1.0, 1.0, 1.0]
    assert recipe.seed == 3
    card = (tmp_path / "new" / "net.v2.md").read_text()
    assert "# Weights `net.v2`" in card
    assert "a table" in card
    assert "More" not in card


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("no folder", r"no run\.json that can be read; give the folder"),
        ("no record", r"no run\.json that can be read; give the folder"),
        ("half a record", r"no run\.json that can be read; give the folder"),
        ("no table", r"no results\.md"),
        ("no weights", r"best\.ckpt: no such file"),
        ("half the weights", r"best\.ckpt: not a checkpoint that uncal\.train wrote"),
        ("too large", r"more than 0: use a smaller model"),
    ],
)
def test_an_unfinished_run_is_a_sentence_and_earlier_weights_stay(
    run: Path, tmp_path: Path, damage: str, message: str
) -> None:
    weights = run / "checkpoints" / "best.ckpt"
    earlier = tmp_path / "net.safetensors"
    earlier.write_text("earlier")
    if damage in ("no record", "half a record"):
        (run / "run.json").unlink()
    if damage == "half a record":
        (run / "run.json").write_text('{"command": ')
    if damage == "no table":
        (run / "results.md").unlink()
    if damage == "no weights":
        weights.unlink()
    if damage == "half the weights":
        weights.write_bytes(weights.read_bytes()[:100])
    given = tmp_path / "nowhere" if damage == "no folder" else run
    limit = 100 if damage == "too large" else 10_000_000
    with patch("uncal.ship.LARGEST_BYTES", limit), pytest.raises(SystemExit, match=message):
        main([str(given), str(tmp_path / "net")])
    assert earlier.read_text() == "earlier"
    assert not (tmp_path / "net.md").exists()
    assert not list(tmp_path.glob(".*.partial"))


@pytest.mark.parametrize("target", ["", ".", ".."])
def test_weights_need_a_name(run: Path, target: str) -> None:
    with pytest.raises(SystemExit, match=r"expected a name, such as weights/unical"):
        main([str(run), target])


def test_a_folder_that_cannot_be_is_a_sentence(run: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="cannot be written"):
        main([str(run), str(tmp_path / "file" / "net")])
