"""What ``ckpt=`` may name, and what is said of everything else."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import torch

from uncal.errors import ConfigurationError
from uncal.models.module import CalibrationModule
from uncal.runs.checkpoint import check_start
from uncal.weights.shipped import load_checkpoint


class Runs:
    """A pickle that would leave a file behind if it were loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (str(self.path),)


def network(width: int = 2) -> CalibrationModule:
    state = {"layer.weight": torch.zeros(width), "calibrator.scores": torch.zeros(3)}
    return cast(CalibrationModule, SimpleNamespace(state_dict=lambda: state))


def checkpoint(path: Path, state: dict[str, torch.Tensor], **more: object) -> Path:
    torch.save({"state_dict": state, "uncal_recipe": {"seed": 0}, **more}, path)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ConfigurationError) as refused:
        load_checkpoint(path)
    said = str(refused.value)
    assert said.startswith(f"ckpt={path}: ")
    assert "\n" not in said
    assert "outputs/*/*/checkpoints/best.ckpt" in said
    return said


def test_no_file_text_and_a_half_file_are_told_apart_from_code(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "none.ckpt")
    text = tmp_path / "text.ckpt"
    text.write_text("hello, this is no checkpoint\n")
    assert "bytes are not those of a checkpoint" in refusal(text)
    (tmp_path / "empty.ckpt").write_bytes(b"")
    assert "not a checkpoint that uncal.train wrote" in refusal(tmp_path / "empty.ckpt")
    half = checkpoint(tmp_path / "half.ckpt", {"a": torch.zeros(1000)})
    half.write_bytes(half.read_bytes()[:500])
    assert "not a checkpoint that uncal.train wrote" in refusal(half)


def test_a_pickle_that_may_run_code_is_refused_and_nothing_is_run(tmp_path: Path) -> None:
    mark, path = tmp_path / "mark", tmp_path / "evil.ckpt"
    path.write_bytes(pickle.dumps(Runs(mark), protocol=2))
    assert "nothing of it was run" in refusal(path)
    torch.save({"state_dict": Runs(mark)}, path)
    assert "nothing of it was run" in refusal(path)
    assert not mark.exists()


def test_another_projects_checkpoint_lacks_what_we_write(tmp_path: Path) -> None:
    path = tmp_path / "other.ckpt"
    torch.save({"state_dict": {}}, path)
    assert "it has no 'uncal_recipe'" in refusal(path)


def test_a_training_goes_on_with_its_own_state_only(tmp_path: Path) -> None:
    weights = {"layer.weight": torch.zeros(2)}
    full = checkpoint(tmp_path / "last.ckpt", weights, optimizer_states=[], epoch=2)
    check_start(network(), full, 3)
    with pytest.raises(ConfigurationError, match=r"layer\.weight: of another size of network"):
        check_start(network(width=3), full, 3)
    other = checkpoint(
        tmp_path / "other.ckpt", {"head.bias": torch.zeros(2)}, optimizer_states=[], epoch=2
    )
    with pytest.raises(ConfigurationError, match=r"layer\.weight, head\.bias: not of this network"):
        check_start(network(), other, 3)
    bare = checkpoint(tmp_path / "best.ckpt", weights)
    with pytest.raises(ConfigurationError, match=r"not the state of their training.*last\.ckpt"):
        check_start(network(), bare, 3)
    with pytest.raises(ConfigurationError, match=r"3 epochs behind it, trainer\.max_epochs=2"):
        check_start(network(), full, 2)
