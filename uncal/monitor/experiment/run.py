"""All cases of the experiment, one after the other."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.monitor.experiment.cases import BLIND, STEP, STILL, Case, Drive, ExperimentSettings
from uncal.monitor.experiment.observe import RememberingReader, Row, exchanged, fresh, observe
from uncal.monitor.experiment.page import write_tables
from uncal.monitor.experiment.summary import MONITOR, Experiment
from uncal.monitor.monitor import Monitor
from uncal.monitor.settings import MonitorSettings, per_dof
from uncal.reporting.run_record import commit_of_code

log = logging.getLogger(__name__)


def run_experiment(config: DictConfig, folder: Path, command: str) -> str:
    """Measure, and write ``observations.csv``, the tables and the page.

    Args:
        config: conf/monitor.yaml with ``+sweeps=monitor``.
        folder: of the run; after every case it holds what has been measured so far.
        command: that started it.

    Returns:
        The page.

    Raises:
        ConfigurationError: a setting does not hold, or there are no references.
    """
    if config.experiment is None:
        raise ConfigurationError("experiment: null; add +sweeps=monitor to the command")
    settings = ExperimentSettings.of(config.experiment)
    whole = cast("Mapping[str, object]", OmegaConf.to_container(config, resolve=True))
    monitor = Monitor(
        config.weights or config.ckpt,
        references=config.references,
        settings=MonitorSettings.of(whole),
    )
    if monitor.references is None:
        raise ConfigurationError(f"references: {monitor.notes[0]}")
    monitor.reader = RememberingReader(monitor.reader)
    rows: list[Row] = []
    page = ""
    cases = settings.cases()
    for number, case in enumerate(cases):
        rows += _case(case, settings, monitor)
        log.info("%s: %d of %d cases", case.name, number + 1, len(cases))
        experiment = Experiment(
            pd.DataFrame(rows),
            settings.onset,
            monitor.settings.window,
            settings.simulation.vehicle.frame_interval_s,
            per_dof(settings.limit_cm, settings.limit_deg),
            np.asarray(monitor.reader.bounds),
        )
        experiment.rows.to_csv(folder / "observations.csv", index=False)
        page = write_tables(
            folder, experiment.tables(), _notes(settings, monitor, cases[: number + 1]), command
        )
    return page


def _case(case: Case, settings: ExperimentSettings, monitor: Monitor) -> Iterator[Row]:
    kept: list[Drive] = []
    largest = {name: max(settings.step_cm) for name in DOF_NAMES[:3]}
    largest |= {name: max(settings.step_deg) for name in DOF_NAMES[3:]}
    blind = case.kind == STILL or (case.kind == STEP and case.size == largest[case.dof])
    for drive in settings.recorded(case):
        frames = drive.frames if case.fault is None else case.fault(drive.frames)
        yield from observe(fresh(monitor), drive, case, frames, MONITOR)
        if blind and len(kept) < settings.drives[BLIND]:
            kept.append(drive)
    for drive, others in exchanged(kept) if blind else ():
        yield from observe(fresh(monitor, apply=False), drive, case, others, BLIND)


def _notes(settings: ExperimentSettings, monitor: Monitor, cases: list[Case]) -> Iterator[str]:
    street = settings.simulation
    interval = street.vehicle.frame_interval_s
    moving = [case for case in cases if case.motion is not None]
    references = monitor.references
    assert references is not None
    yield (
        f"**Simulated**, rigs that no training has seen: {settings.drives[STILL]} drives at rest, "
        f"{sum(case.drives for case in moving)} in which the LiDAR moves in its mount and the "
        f"nominal extrinsic is assumed ({len(moving)} motions of the same first streets), of "
        f"{settings.frames} frames {interval:g} s apart; motions and faults begin at "
        f"frame {settings.onset} and last to the end. Every drive begins with a fresh monitor."
    )
    yield (
        f"Window of {monitor.settings.window} frames, level {monitor.settings.level:g}, "
        f"references: {references.label}, {len(references.drives)} windows of "
        f"{len(set(references.drives))} drives. The plainer watchers alarm beyond "
        f"{settings.limit_cm:g} cm or {settings.limit_deg:g}° in any DoF."
    )
    yield f"Seed of the simulation {street.seed}, commit {commit_of_code() or 'unknown'}."
