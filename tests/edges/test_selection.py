import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.edges.selection import SHARES, select_edges
from uncal.edges.sweep import COLUMNS, KIND, KINDS, STRENGTH


def edges_of(*counts: int) -> NDArray[np.float32]:
    """So many of each kind, of random strength."""
    rng = np.random.default_rng(0)
    edges = rng.random((sum(counts), len(COLUMNS))).astype(np.float32)
    edges[:, KIND] = np.repeat(np.arange(len(KINDS)), counts)
    return rng.permutation(edges)


def counts_of(edges: NDArray[np.float32]) -> list[int]:
    return [int(n) for n in np.bincount(edges[:, KIND].astype(int), minlength=len(KINDS))]


def rows_of(edges: NDArray[np.float32]) -> set[bytes]:
    return {row.tobytes() for row in edges}


def test_shares_are_of_the_whole() -> None:
    assert sum(SHARES) == pytest.approx(1.0)
    assert len(SHARES) == len(KINDS)


def test_each_kind_has_its_share_where_all_have_plenty() -> None:
    kept = select_edges(edges_of(*[500] * 6), 1000, seed=0)
    assert counts_of(kept) == pytest.approx([1000 * share for share in SHARES], abs=1)


def test_noise_of_one_kind_does_not_crowd_out_the_others() -> None:
    kept = select_edges(edges_of(40, 10, 5000, 30, 5, 5000), 200, seed=0)
    counts = counts_of(kept)
    assert 196 <= len(kept) <= 200
    assert counts[0] == 40
    assert counts[1] == 10
    assert counts[3] == 30
    assert counts[4] == 5
    # What the others do not need goes to those that have more, by their shares.
    assert counts[2] == pytest.approx(counts[5], abs=1)


def test_the_strongest_of_each_kind_are_kept() -> None:
    edges = edges_of(*[300] * 6)
    kept = select_edges(edges, 240, seed=0)
    for kind, count in enumerate(counts_of(kept)):
        whole = edges[edges[:, KIND] == kind, STRENGTH]
        mine = kept[kept[:, KIND] == kind, STRENGTH]
        np.testing.assert_array_equal(np.sort(mine), np.sort(whole)[len(whole) - count :])


@pytest.mark.parametrize(
    "counts", [(3, 2, 1, 4, 0, 5), (15, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 0), (1, 1, 1, 1, 1, 10)]
)
def test_all_are_kept_where_there_are_no_more_than_wanted(counts: tuple[int, ...]) -> None:
    edges = edges_of(*counts)
    for most in (15, 16, 1000):
        kept = select_edges(edges, most, seed=1)
        assert kept.shape == edges.shape
        assert rows_of(kept) == rows_of(edges)


def test_the_same_seed_gives_the_same_order_and_another_the_same_edges() -> None:
    edges = edges_of(*[100] * 6)
    first, again, other = (select_edges(edges, 200, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert rows_of(first) == rows_of(other)


def test_any_first_part_is_a_fair_sample() -> None:
    kept = select_edges(edges_of(*[2000] * 6), 4000, seed=0)
    half = counts_of(kept[:2000])
    # Within five standard deviations of drawing without replacement.
    assert half == pytest.approx([2000 * share for share in SHARES], abs=5 * 0.5 * 20)


def test_never_more_than_wanted() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        counts = rng.integers(0, 60, 6).tolist()
        most = int(rng.integers(1, 200))
        kept = select_edges(edges_of(*counts), most, seed=0)
        assert min(sum(counts), most) - 6 <= len(kept) <= most
        assert all(a <= b for a, b in zip(counts_of(kept), counts, strict=True))
