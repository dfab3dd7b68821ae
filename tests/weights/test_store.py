import json
import threading
from pathlib import Path

import pytest
import torch

from uncal.weights.load_or_train import CHECKPOINT, RECORD, Trained, WeightStore, load_or_train

INGREDIENTS = {"seed": 0, "frames": "abc"}
TRAINED = Trained(seconds=12.5, epochs=3, finished="2026-01-01T00:00:00", run="r", commit=None)


class Training:
    """Counts how often it is called, and writes a checkpoint."""

    def __init__(self, folder: Path, content: str = "weights") -> None:
        self.path = folder / "run.ckpt"
        self.content = content
        self.starts: list[Path | None] = []

    def __call__(self, start: Path | None) -> Path:
        self.starts.append(start)
        self.path.write_text(self.content)
        return self.path


def get(store: WeightStore, train: Training, folder: Path, retrain: bool = False) -> bool:
    last = folder / "last.ckpt"
    weights = load_or_train(store, train, run=folder, epochs=3, last=last, retrain=retrain)
    assert weights.path.read_text() == train.content
    assert weights.fingerprint == store.fingerprint
    return weights.reused


def test_the_second_one_finds_what_the_first_trained(tmp_path: Path) -> None:
    train = Training(tmp_path)
    assert not get(WeightStore(tmp_path / "store", INGREDIENTS), train, tmp_path)
    assert get(WeightStore(tmp_path / "store", dict(INGREDIENTS)), train, tmp_path)
    assert train.starts == [None]


def test_other_ingredients_are_other_weights(tmp_path: Path) -> None:
    train = Training(tmp_path)
    for seed in (0, 1):
        store = WeightStore(tmp_path / "store", {**INGREDIENTS, "seed": seed})
        assert not get(store, train, tmp_path)
        kept = json.loads((store.folder / "ingredients.json").read_text())
        assert kept == {**INGREDIENTS, "seed": seed}
    assert train.starts == [None, None]


def test_retrain_trains_and_the_new_weights_replace_the_old(tmp_path: Path) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    get(store, Training(tmp_path, "old"), tmp_path)
    again = Training(tmp_path, "new")
    assert not get(store, again, tmp_path, retrain=True)
    assert len(again.starts) == 1
    assert store.checkpoint.read_text() == "new"


def test_an_interrupted_training_goes_on_and_retrain_starts_anew(tmp_path: Path) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    last = tmp_path / "last.ckpt"

    def interrupted(start: Path | None) -> Path:
        torch.save({"epoch": 1}, last)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        load_or_train(store, interrupted, run=tmp_path, epochs=3, last=last, retrain=False)
    assert store.find() is None
    assert store.interrupted() == last.resolve()

    elsewhere = tmp_path / "second"
    elsewhere.mkdir()
    anew = Training(elsewhere)
    with pytest.raises(ZeroDivisionError):
        load_or_train(
            store,
            lambda start: Path(str(anew(start))) / str(1 // 0),
            run=elsewhere,
            epochs=3,
            last=elsewhere / "last.ckpt",
            retrain=False,
        )
    # It was given the first one's checkpoint, and the next one will be too: none was written since.
    assert anew.starts == [last.resolve()]
    assert store.interrupted() == last.resolve()

    forced = Training(elsewhere)
    assert not get(store, forced, elsewhere, retrain=True)
    assert forced.starts == [None]
    assert store.interrupted() is None


def test_a_lost_checkpoint_of_an_interrupted_training_is_no_start(tmp_path: Path) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    store.folder.mkdir(parents=True)
    store.begin(tmp_path / "gone.ckpt")
    assert store.interrupted() is None


def test_a_checkpoint_cut_short_is_no_start(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    store.folder.mkdir(parents=True)
    last = tmp_path / "last.ckpt"
    torch.save({"weights": torch.zeros(1000)}, last)
    store.begin(last)
    assert store.interrupted() == last
    last.write_bytes(last.read_bytes()[:2000])
    assert store.interrupted() is None
    assert f"{last} is damaged" in caplog.text


@pytest.mark.parametrize("damage", ["not json", "[1]", '{"seconds": 1}'])
def test_a_damaged_record_means_training_again(tmp_path: Path, damage: str) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    train = Training(tmp_path)
    get(store, train, tmp_path)
    (store.folder / RECORD).write_text(damage)
    assert not get(store, train, tmp_path)
    assert len(train.starts) == 2


def test_a_checkpoint_without_its_record_is_not_finished(tmp_path: Path) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    store.folder.mkdir(parents=True)
    (store.folder / CHECKPOINT).write_text("half")
    assert store.find() is None
    source = tmp_path / "best.ckpt"
    source.write_text("whole")
    store.keep(source, TRAINED)
    assert store.find() == TRAINED
    assert store.checkpoint.read_text() == "whole"


def test_parallel_jobs_train_once(tmp_path: Path) -> None:
    started, proceed = threading.Event(), threading.Event()
    train = Training(tmp_path)

    def slow(start: Path | None) -> Path:
        started.set()
        assert proceed.wait(20)
        return train(start)

    reused: list[bool] = []

    def job(how: object) -> None:
        store = WeightStore(tmp_path / "store", INGREDIENTS)
        weights = load_or_train(
            store,
            how,  # type: ignore[arg-type]
            run=tmp_path,
            epochs=1,
            last=None,
            retrain=False,
        )
        reused.append(weights.reused)

    first = threading.Thread(target=job, args=(slow,))
    first.start()
    assert started.wait(20)
    second = threading.Thread(target=job, args=(train,))
    second.start()
    second.join(timeout=0.5)
    assert second.is_alive()
    assert train.starts == []
    proceed.set()
    first.join(20)
    second.join(20)
    assert train.starts == [None]
    assert reused == [False, True]


def test_a_sentence_says_whether_weights_were_trained_now_or_before(tmp_path: Path) -> None:
    store = WeightStore(tmp_path / "store", INGREDIENTS)
    train = Training(tmp_path)
    how = {"run": tmp_path, "epochs": 3, "last": None, "retrain": False}
    first = load_or_train(store, train, **how)  # type: ignore[arg-type]
    second = load_or_train(store, train, **how)  # type: ignore[arg-type]
    assert "trained in this run (3 epochs" in first.sentence()
    assert "reused, not trained again: trained by" in second.sentence()
    assert store.fingerprint in second.sentence()
    assert "retrain=true" in second.sentence()
