from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch import distributed as dist
from torch.multiprocessing.spawn import spawn

from uncal.uncertainty import ConformalCalibrator, UncertaintyError
from uncal.uncertainty.gather import gather_by_id

LEVELS = (0.5, 0.8, 0.9)


def test_one_process_sorts_and_keeps_the_first() -> None:
    ids = torch.tensor([5, 1, 5, 3, 1])
    rows = torch.tensor([[5.0], [1.0], [50.0], [3.0], [10.0]])
    flags = torch.tensor([True, False, False, True, True])
    unique, kept, kept_flags = gather_by_id(ids, rows, flags)
    assert unique.tolist() == [1, 3, 5]
    assert kept.tolist() == [[1.0], [3.0], [5.0]]
    assert kept_flags.tolist() == [False, True, True]


def test_one_process_without_rows_or_tensors() -> None:
    unique, rows = gather_by_id(torch.empty(0, dtype=torch.int64), torch.empty(0, 6))
    assert (unique.shape, rows.shape) == ((0,), (0, 6))
    assert [t.tolist() for t in gather_by_id(torch.tensor([2, 1, 2]))] == [[1, 2]]


@pytest.mark.parametrize(
    ("ids", "rows", "message"),
    [
        (torch.zeros(2), torch.zeros(2, 6), r"ids of shape \(2,\) and type torch.float32"),
        (torch.zeros(2, 1, dtype=torch.int64), torch.zeros(2, 6), r"ids of shape \(2, 1\)"),
        (torch.tensor(1), torch.zeros(1, 6), r"ids of shape \(\)"),
        (torch.arange(2), torch.zeros(3, 6), r"tensor 0 of shape \(3, 6\) for 2 ids"),
        (torch.arange(2), torch.tensor(1.0), r"tensor 0 of shape \(\)"),
    ],
)
def test_refusals(ids: Tensor, rows: Tensor, message: str) -> None:
    with pytest.raises(UncertaintyError, match=message):
        gather_by_id(ids, rows)


def _samples() -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean, σ, target (23, 6) and a flag of 23 samples, in the order of their ids 0…22."""
    generator = torch.Generator().manual_seed(0)
    mean, target = torch.randn(2, 23, 6, generator=generator, dtype=torch.float64).unbind()
    std = 0.1 + torch.rand(23, 6, generator=generator)
    return mean, std, target, torch.arange(23) % 3 == 0


def _unequal_with_padding(rank: int) -> dict[str, object]:
    # Sampler order, every other sample; then repeats as padding, with values that must not win.
    picks = torch.arange(rank, 23, 2).flip(0)
    padding = torch.tensor([0, 1, 2] if rank else [], dtype=torch.int64)
    mean, std, target, flag = _samples()
    ids, *rows = gather_by_id(
        torch.cat([picks, padding]),
        torch.cat([mean[picks], mean[padding] + 9]),
        torch.cat([std[picks], std[padding] + 9]),
        torch.cat([target[picks], target[padding] - 9]),
        torch.cat([flag[picks], ~flag[padding]]),
        torch.zeros(len(picks) + len(padding), 0),
    )
    calibrator = ConformalCalibrator().fit(rows[0], rows[1], rows[2])
    quantiles = torch.stack([calibrator.quantile(level) for level in LEVELS])
    return {"ids": ids, "rows": rows, "quantiles": quantiles}


def _one_process_is_empty(rank: int) -> dict[str, object]:
    mean, *_, flag = _samples()
    # Process 0 has seen nothing: it does not know what a row looks like.
    ids = torch.tensor([4, 3] if rank else [], dtype=torch.int64)
    empty = torch.empty(0)
    some = gather_by_id(ids, *((mean[ids], flag[ids]) if rank else (empty, empty)))
    return {"some": some, "none": gather_by_id(ids[:0], empty)}


def _wrong_arguments(rank: int) -> dict[str, object]:
    ids, messages = torch.arange(2), []
    for arguments in (
        (ids if rank else ids.float(), torch.zeros(2, 6)),
        (ids, torch.zeros(2, 6 - rank)),
        (ids, torch.zeros(2, 6, dtype=torch.float64 if rank else torch.float32)),
        (ids[:rank], *[torch.zeros(rank, 6)] * (1 + rank)),
    ):
        try:
            gather_by_id(*arguments)
        except UncertaintyError as error:
            messages.append(str(error))
    return {"messages": messages}


def _work(rank: int, folder: str) -> None:
    dist.init_process_group("gloo", init_method=f"file://{folder}/init", rank=rank, world_size=2)
    torch.set_num_threads(1)  # two processes may share few cores
    saved = {**_unequal_with_padding(rank), **_one_process_is_empty(rank), **_wrong_arguments(rank)}
    torch.save(saved, Path(folder) / f"{rank}.pt")
    dist.destroy_process_group()


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    """What each of two processes has gathered; started once, since starting is what takes long."""
    folder = tmp_path_factory.mktemp("gather")
    spawn(_work, args=(str(folder),), nprocs=2)  # type: ignore[no-untyped-call]
    return [torch.load(folder / f"{rank}.pt") for rank in range(2)]


@pytest.mark.slow
def test_unequal_sizes_and_padding(two_processes: list[dict[str, object]]) -> None:
    whole = _samples()
    for saved in two_processes:
        ids, rows = saved["ids"], saved["rows"]
        assert isinstance(ids, Tensor)
        assert isinstance(rows, list)
        assert ids.tolist() == list(range(23))
        # 0 and 2 are in process 0; 1 in process 1, before its repeats.
        for row, expected in zip(rows[:4], whole, strict=True):
            assert row.dtype == expected.dtype
            assert torch.equal(row, expected)
        assert rows[4].shape == (23, 0)


@pytest.mark.slow
def test_both_processes_calibrate_as_one_would(two_processes: list[dict[str, object]]) -> None:
    mean, std, target, _ = _samples()
    alone = ConformalCalibrator().fit(mean, std, target)
    expected = torch.stack([alone.quantile(level) for level in LEVELS])
    assert expected.isfinite().all()
    for saved in two_processes:
        assert isinstance(saved["quantiles"], Tensor)
        assert torch.equal(saved["quantiles"], expected)


@pytest.mark.slow
def test_a_process_without_samples(two_processes: list[dict[str, object]]) -> None:
    mean, *_, flag = _samples()
    for saved in two_processes:
        some, none = saved["some"], saved["none"]
        assert isinstance(some, tuple)
        assert isinstance(none, tuple)
        assert some[0].tolist() == [3, 4]
        assert some[1].dtype == torch.float64
        assert torch.equal(some[1], mean[3:5])
        assert torch.equal(some[2], flag[3:5])
        assert [tensor.shape for tensor in none] == [(0,), (0,)]


@pytest.mark.slow
def test_what_is_wrong_on_one_is_said_on_both(two_processes: list[dict[str, object]]) -> None:
    first, second = (saved["messages"] for saved in two_processes)
    assert isinstance(first, list)
    assert first == second
    assert len(first) == 4
    assert first[0].startswith("process 0: ids of shape (2,) and type torch.float32")
    assert first[1].startswith("process 1 brings 2 rows of (5,) torch.float32")
    assert "(6,) torch.float64" in first[2]
    assert "process 0 brings 0 rows" in first[3]
