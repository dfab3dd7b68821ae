"""All cases of the experiment, one after the other."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.experiment.cases import BLIND, STEP, STILL, Case, ExperimentSettings
from uncal.monitor.experiment.figures import steps_figure
from uncal.monitor.experiment.observe import RememberingReader, Row, exchanged, fresh, observe
from uncal.monitor.experiment.page import write_tables
from uncal.monitor.experiment.store import Store
from uncal.monitor.experiment.summary import MONITOR, Experiment
from uncal.monitor.monitor import Monitor
from uncal.monitor.settings import MonitorSettings, per_dof
from uncal.recordings.frame import Frame
from uncal.reporting.figures.style import save
from uncal.reporting.run_record import commit_of_code

log = logging.getLogger(__name__)

PAGE_S = 60.0
"""Seconds after which tables and page are written again."""


def run_experiment(config: DictConfig, folder: Path, command: str) -> str:
    """Measure, and write ``observations.csv``, the tables, the page and a figure of the steps.

    Args:
        config: conf/monitor.yaml with ``+sweeps=monitor``.
        folder: of the run; holds what has been measured so far, and is gone on from.
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
    store = Store(folder, _about(config, monitor))
    cases = settings.cases()
    parts = _parts(settings, cases)
    page, shown = "", -math.inf
    for done, (name, case, drive, watcher) in enumerate(parts, start=1):
        if not store.has(name):
            store.add(name, _observed(settings, monitor, case, drive, watcher))
            log.info("%s: %d of %d drives", name, done, len(parts))
        if time.monotonic() - shown > PAGE_S or done == len(parts):
            rows = store.rows(part[0] for part in parts)
            page, shown = _write(folder, rows, settings, monitor, cases, command), time.monotonic()
    return page


def _parts(settings: ExperimentSettings, cases: list[Case]) -> list[tuple[str, Case, int, str]]:
    """Name, case, drive and watcher of all there is to be seen.

    A drive of every case, then the next one, so that what is there early is of all cases.
    """
    largest = dict.fromkeys(DOF_NAMES[:3], max(settings.step_cm))
    largest |= dict.fromkeys(DOF_NAMES[3:], max(settings.step_deg))
    found = []
    for drive in range(settings.drives[STILL]):
        for case in cases:
            if drive < case.drives:
                found.append((f"{case.name}.{drive}.{MONITOR}", case, drive, MONITOR))
            big = case.kind == STILL or (case.kind == STEP and case.size == largest[case.dof])
            if big and drive < settings.drives[BLIND]:
                found.append((f"{case.name}.{drive}.{BLIND}", case, drive, BLIND))
    return found


def _observed(
    settings: ExperimentSettings, monitor: Monitor, case: Case, number: int, watcher: str
) -> Iterator[Row]:
    drive = settings.recorded(case, number)
    if watcher == BLIND:
        other = settings.recorded(case, (number + 1) % settings.drives[BLIND])
        frames: Iterable[Frame] = exchanged(drive, other)
    else:
        frames = drive.frames if case.fault is None else case.fault(drive.frames)
    return observe(fresh(monitor, apply=watcher == MONITOR), drive, case, frames, watcher)


def _write(
    folder: Path,
    rows: pd.DataFrame,
    settings: ExperimentSettings,
    monitor: Monitor,
    cases: list[Case],
    command: str,
) -> str:
    experiment = Experiment(
        rows,
        settings.onset,
        monitor.settings.window,
        settings.simulation.vehicle.frame_interval_s,
        per_dof(settings.limit_cm, settings.limit_deg),
        np.asarray(monitor.reader.bounds),
    )
    rows.to_csv(folder / "observations.csv", index=False)
    tables = experiment.tables()
    if (figure := steps_figure(tables)) is not None:
        save(figure, folder)
    return write_tables(folder, tables, _notes(settings, monitor, rows, cases), command)


def _about(config: DictConfig, monitor: Monitor) -> dict[str, object]:
    """What must be the same for going on."""
    whole = cast("dict[str, object]", OmegaConf.to_container(config, resolve=True))
    experiment = dict(cast("dict[str, object]", whole["experiment"]))
    # Where recordings lie and who makes them changes no number, and more drives only add some.
    for key in ("root", "workers", "drives"):
        experiment.pop(key)
    references = monitor.references
    assert references is not None
    arrays = (references.error, references.std, references.frames, references.windows)
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
    return {
        "weights": monitor.reader.module.engine.identity().weights,
        "references": digest.hexdigest()[:16],
        "settings": {key: whole[key] for key in MonitorSettings.__dataclass_fields__},
        "experiment": experiment,
    }


def _notes(
    settings: ExperimentSettings, monitor: Monitor, rows: pd.DataFrame, cases: list[Case]
) -> Iterator[str]:
    street = settings.simulation
    interval = street.vehicle.frame_interval_s
    seen = rows[rows["watcher"] == MONITOR].groupby("case")["drive"].nunique()
    moving = [case.name for case in cases if case.motion is not None and case.name in seen]
    wanted = sum(case.drives for case in cases)
    references = monitor.references
    assert references is not None
    yield (
        f"**Simulated**, rigs that no training has seen: {seen.get(STILL, 0)} drives at rest, "
        f"{seen[moving].sum()} in which the LiDAR moves in its mount and the "
        f"nominal extrinsic is assumed ({len(moving)} motions of the same first streets), of "
        f"{settings.frames} frames {interval:g} s apart; motions and faults begin at "
        f"frame {settings.onset} and last to the end. Every drive begins with a fresh monitor."
    )
    if seen.sum() < wanted:
        yield f"**Not finished**: {seen.sum()} of {wanted} drives (faults included)."
    yield (
        f"Window of {monitor.settings.window} frames, level {monitor.settings.level:g}, "
        f"references: {references.label}, {len(references.drives)} windows of "
        f"{len(set(references.drives))} drives. The plainer watchers alarm beyond "
        f"{settings.limit_cm:g} cm or {settings.limit_deg:g}° in any DoF."
    )
    yield f"Seed of the simulation {street.seed}, commit {commit_of_code() or 'unknown'}."
