"""What goes between a job's process and the launcher's."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import joblib  # type: ignore[import-untyped]
import pytest
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import CompactHydraException

from uncal.multirun.callback import make_portable, restore_start_method


class CannotTravelError(Exception):
    """Its constructor takes two arguments, but pickle gives it the one message."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


def failed(error: Exception) -> JobReturn:
    job = JobReturn(overrides=[], status=JobStatus.FAILED)
    job.return_value = error
    return job


def test_an_error_that_cannot_travel_is_replaced_by_its_message() -> None:
    job = failed(CannotTravelError("a", "b"))
    make_portable(job, "CannotTravelError: a and b")
    with pytest.raises(CompactHydraException, match="CannotTravelError: a and b"):
        _ = job.return_value


def test_an_error_that_can_travel_stays() -> None:
    error = ValueError("one pass")
    job = failed(error)
    make_portable(job, "one pass")
    with pytest.raises(ValueError, match="one pass") as raised:
        _ = job.return_value
    assert raised.value is error


def square_in_another_process(value: int) -> tuple[str | None, int]:
    restore_start_method()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        found = pool.submit(pow, value, 2).result()
    return multiprocessing.get_start_method(allow_none=True), found


def test_a_process_of_joblib_starts_others() -> None:
    jobs = joblib.Parallel(n_jobs=2)(joblib.delayed(square_in_another_process)(v) for v in (2, 3))
    assert [found for _, found in jobs] == [4, 9]
    assert {method for method, _ in jobs} == {multiprocessing.get_start_method()}


def test_elsewhere_it_changes_nothing() -> None:
    before = multiprocessing.get_start_method(allow_none=True)
    restore_start_method()
    assert multiprocessing.get_start_method(allow_none=True) == before
