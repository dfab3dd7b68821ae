from pathlib import Path

import pytest
import torch

from uncal.uncertainty.dropout.pass_memory import PassMemory
from uncal.uncertainty.dropout.prediction import Prediction

FRAMES = ["a", "b", "c"]


def samples(passes: int) -> torch.Tensor:
    """Pass p of frame f gives (10 p + f, -f)."""
    p, f = torch.meshgrid(torch.arange(passes), torch.arange(3), indexing="ij")
    return torch.stack([10.0 * p + f, -1.0 * f], dim=2)


def memory(folder: Path, passes: int, weights: str = "abc") -> PassMemory:
    return PassMemory(folder / weights, passes)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    first = memory(tmp_path, 4)
    assert first.recall("test", FRAMES) is None
    first.remember("test", FRAMES, samples(4))
    first.save()
    assert first.origin("test") == "computed"
    return tmp_path


@pytest.mark.parametrize("passes", [2, 3, 4])
def test_many_passes_answer_for_fewer(kept: Path, passes: int) -> None:
    again = memory(kept, passes)
    found = again.recall("test", ["c", "a"])
    assert found is not None
    torch.testing.assert_close(found, samples(4)[:passes][:, [2, 0]], rtol=0, atol=0)
    whole = Prediction.of(samples(4), keep=True).first(passes)
    torch.testing.assert_close(Prediction.of(found).std, whole.std[[2, 0]], rtol=0, atol=0)
    assert again.origin("test") == "reused"


def test_fewer_passes_are_given_and_other_weights_other_splits_and_new_frames_are_not_known(
    kept: Path,
) -> None:
    fewer = memory(kept, 5)
    found = fewer.recall("test", FRAMES)
    assert found is not None
    assert len(found) == 4
    assert fewer.origin("test") == "computed"
    assert memory(kept, 4, weights="xyz").recall("test", FRAMES) is None
    assert memory(kept, 4).recall("uncertainty_calibration", FRAMES) is None
    assert memory(kept, 4).recall("test", ["a", "d"]) is None


def test_more_passes_replace_fewer_and_fewer_do_not_replace_more(kept: Path) -> None:
    more, fewer = memory(kept, 6), memory(kept, 2)
    fewer.remember("test", FRAMES, samples(2))
    more.remember("test", FRAMES, samples(6))
    more.save()
    fewer.save()
    found = memory(kept, 6).recall("test", FRAMES)
    assert found is not None
    torch.testing.assert_close(found, samples(6))


def test_what_is_partly_known_is_said_to_be(kept: Path) -> None:
    again = memory(kept, 4)
    assert again.recall("test", ["a"]) is not None
    assert again.recall("test", ["d"]) is None
    again.remember("test", ["d"], samples(4)[:, :1])
    assert again.origin("test") == "partly reused"
    again.save()
    assert memory(kept, 4).recall("test", ["d", "b"]) is not None


def test_a_damaged_file_is_computed_again(kept: Path, caplog: pytest.LogCaptureFixture) -> None:
    (path,) = kept.rglob("test.pt")
    path.write_bytes(b"damage")
    again = memory(kept, 4)
    assert again.recall("test", FRAMES) is None
    assert "test.pt cannot be read" in caplog.text
    again.remember("test", FRAMES, samples(4))
    again.save()
    assert memory(kept, 4).recall("test", FRAMES) is not None


def test_forgetting_means_computing_again(kept: Path) -> None:
    forgetful = memory(kept, 4)
    forgetful.forget()
    assert forgetful.recall("test", FRAMES) is None
    assert memory(kept, 4).recall("test", FRAMES) is None
