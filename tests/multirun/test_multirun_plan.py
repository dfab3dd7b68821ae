"""What is planned, and how many threads each job gets."""

from __future__ import annotations

import os

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, open_dict

from uncal.multirun.callback import planned_jobs, share_cores, threads_per_job
from uncal.settings.configuration import CONFIG_DIR


def multirun(*arguments: str, **params: str) -> DictConfig:
    """As Hydra hands it to on_multirun_start."""
    launchers = [each for each in arguments if each.startswith("hydra/")]
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", launchers, return_hydra_config=True)
    with open_dict(config):
        config.hydra.overrides.task = [each for each in arguments if each not in launchers]
        config.hydra.sweeper.params = params
    return config


def test_every_combination_is_planned_in_order() -> None:
    config = multirun("mcd.passes=5,10", "+x=a", "seed=range(2)", **{"interval": "absolute,cqr"})
    jobs = planned_jobs(config)
    assert jobs is not None
    assert len(jobs) == 8
    first = {"interval": "absolute", "mcd.passes": "5", "x": "a", "seed": "0"}
    assert jobs[0] == first
    assert jobs[1] == first | {"seed": "1"}
    assert jobs[-1] == {"interval": "cqr", "mcd.passes": "10", "x": "a", "seed": "1"}


def test_what_a_job_resolves_is_planned_as_it_records_it() -> None:
    """A root named after the swept dataset, for instance, is another one in every job."""
    config = multirun("dataset.root=data/${dataset.name}", **{"dataset": "demo,demo_one_rig"})
    jobs = planned_jobs(config)
    assert jobs is not None
    assert [job["dataset"] for job in jobs] == ["demo", "demo_one_rig"]
    assert {job["dataset.root"] for job in jobs} == {r"data/$\{dataset.name\}"}


@pytest.mark.parametrize(
    "argument", ["mcd.passes=interval(1,5)", "interval=glob(*)", "mcd.passes=["]
)
def test_what_only_the_sweeper_knows_is_not_guessed(argument: str) -> None:
    assert planned_jobs(multirun(argument)) is None


def test_another_sweeper_may_choose_as_it_goes() -> None:
    config = multirun("mcd.passes=5,10")
    config.hydra.sweeper._target_ = "hydra_plugins.hydra_optuna_sweeper.OptunaSweeper"
    assert planned_jobs(config) is None


@pytest.mark.parametrize(
    ("launcher", "n_jobs", "cpus_per_task", "planned", "threads"),
    [
        ("BasicLauncher", None, None, 4, None),
        ("JoblibLauncher", 2, None, 4, 8),
        ("JoblibLauncher", -1, None, 4, 4),  # as many jobs at once as there are
        ("JoblibLauncher", -1, None, 40, 1),
        ("JoblibLauncher", -2, None, None, 1),
        ("LocalLauncher", None, None, 3, 5),
        ("LocalLauncher", None, 6, 3, 6),
        ("SlurmLauncher", None, 6, 3, 6),
        ("SlurmLauncher", None, None, 3, None),  # elsewhere, nobody knows on how many cores
    ],
)
def test_jobs_share_16_cores(
    launcher: str,
    n_jobs: int | None,
    cpus_per_task: int | None,
    planned: int | None,
    threads: int | None,
) -> None:
    config = {"_target_": f"a.{launcher}", "n_jobs": n_jobs, "cpus_per_task": cpus_per_task}
    assert threads == threads_per_job(config, planned=planned, cores=16)


@pytest.mark.parametrize(
    ("launcher", "expected"), [("joblib", "1"), ("submitit_local", "1"), ("basic", None)]
)
def test_the_processes_inherit_it(
    launcher: str, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "")  # so that it is put back as it was
    monkeypatch.delenv("OMP_NUM_THREADS")
    monkeypatch.setattr("joblib.cpu_count", lambda: 2)
    config = multirun("mcd.passes=5,10,25", f"hydra/launcher={launcher}")
    share_cores(config, planned_jobs(config))
    assert os.environ.get("OMP_NUM_THREADS") == expected


def test_what_the_user_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    config = multirun("mcd.passes=5,10", "hydra/launcher=joblib")
    share_cores(config, planned_jobs(config))
    assert os.environ["OMP_NUM_THREADS"] == "7"
