"""The two tasks of ``python -m uncal.monitor``: watching a stream, and making references."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import cast

import torch
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError, UncalError
from uncal.monitor.bag_source import BagSettings
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.loop import Loop, outputs_of
from uncal.monitor.monitor import Monitor
from uncal.monitor.reference_windows import make_references
from uncal.monitor.references import SIMULATED, references_beside
from uncal.monitor.run_folder import LINES, TABLE, RunFolder
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.sources import SourceSettings, check_source, open_recording, stream
from uncal.monitor.verdict import VERDICTS
from uncal.monitor.view import View
from uncal.simulation.manifest import MANIFEST_NAME
from uncal.system.disk import check_writable
from uncal.weights.shipped import find_weights, shipped_names

log = logging.getLogger(__name__)


def chosen(config: DictConfig) -> str:
    """What the user asks for.

    Args:
        config: conf/monitor.yaml with overrides.

    Returns:
        ``calibrate`` or ``watch``.

    Raises:
        ConfigurationError: no weights, or not one of the two.
    """
    if (config.weights is None) == (config.ckpt is None):
        raise ConfigurationError(
            f"weights={config.weights}, ckpt={config.ckpt}: give one of them; shipped weights are "
            f"{', '.join(shipped_names()) or 'none'}"
        )
    if (config.source is None) == (config.calibrate is None):
        raise ConfigurationError(
            f"source={config.source}, calibrate={config.calibrate}: give one of them: a folder to "
            "watch, or one with trusted extrinsics to make references from"
        )
    return "watch" if config.calibrate is None else "calibrate"


def calibrate(config: DictConfig, folder: Path) -> str:
    """Make references from recordings with trusted extrinsics.

    Args:
        config: conf/monitor.yaml with overrides.
        folder: of the run; not used, since references belong beside their weights.

    Returns:
        A summary.

    Raises:
        UncalError: the recordings hold no full window, or the file cannot be written.
    """
    weights = find_weights(str(config.weights or config.ckpt))
    settings = _settings(config)
    path = Path(config.references) if config.references else references_beside(weights)
    check_writable(path)
    source = _source(config, config.calibrate)
    check_source(source)
    recording = open_recording(source)
    reader = EvidenceReader(weights, _device(), settings.seed)
    simulated = (Path(config.calibrate) / MANIFEST_NAME).is_file()
    label = f"{SIMULATED * simulated}{config.calibrate}"
    references = make_references(recording, reader, settings, label)
    try:
        references.save(path)
    except OSError as error:
        raise UncalError(
            f"{path}: cannot be written ({error.strerror}); name another file with references=…"
        ) from error
    drives = len(set(references.drives))
    lines = [
        f"{len(references.drives)} windows of {settings.window} frames, {drives} drives, from "
        f"{config.calibrate}: {path}"
    ]
    try:
        references.check_level(settings.level, settings.exchangeable)
    except ConfigurationError as error:
        lines.append(f"Too few for the settings given: {error}")
    return "\n".join(lines)


def watch(config: DictConfig, folder: Path) -> str:
    """Run over a stream; what a folder holds of an earlier run is gone on from.

    Args:
        config: conf/monitor.yaml with overrides.
        folder: of the run.

    Returns:
        A summary.
    """
    weights = str(config.weights or config.ckpt)
    settings, source = _settings(config), _source(config, config.source)
    check_source(source)
    monitor = Monitor(weights, references=config.references, settings=settings)
    for note in monitor.notes:
        log.warning("%s", note)
    about = {
        "weights": monitor.reader.module.engine.identity().weights,
        "source": str(source.root.resolve()),
        "settings": OmegaConf.to_container(OmegaConf.masked_copy(config, _kept(config))),
    }
    with (
        RunFolder(folder, monitor, about) as run,
        View(monitor) as view,
        ExitStack() as stack,
    ):
        if run.resumed:
            log.info("going on after %d frames in %s", run.resumed, folder)
        outputs = outputs_of(
            monitor, folder, run.resumed, config.tensorboard, config.overlays, config.rerun
        )
        for output in outputs:
            stack.callback(output.close)
        loop = Loop(monitor, run, outputs, view)
        try:
            loop.over(stream(source, run.reported, time.monotonic))
        except KeyboardInterrupt:
            log.warning("interrupted; the same command with hydra.run.dir=%s goes on", folder)
        counts, seen = dict(run.counts), run.resumed + loop.frames
    if not seen:
        return f"No frame in {source.root}."
    told = ", ".join(f"{counts[name]} {name}" for name in VERDICTS if counts.get(name))
    lines = [f"{seen} frames: {told}", "" if loop.last is None else view.estimate(loop.last)]
    if loop.changes:
        lines.append(f"The extrinsic in use was changed {loop.changes} time(s).")
    lines.append(loop.shares())
    transform = monitor.static_transform()
    files = [] if transform is None else transform.write(folder / "estimate")
    lines.append(f"{folder / LINES}, {', '.join([TABLE, *(path.name for path in files)])}")
    return "\n".join(filter(None, lines))


def _device() -> torch.device:
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def _settings(config: DictConfig) -> MonitorSettings:
    whole = OmegaConf.to_container(config, resolve=True)
    return MonitorSettings.of(cast("Mapping[str, object]", whole))


def _kept(config: DictConfig) -> list[str]:
    """Settings that must be the same for going on."""
    return [str(key) for key in config if key in MonitorSettings.__dataclass_fields__]


def _source(config: DictConfig, root: str) -> SourceSettings:
    return SourceSettings(
        root=Path(root).expanduser(),
        drives=None if config.drives is None else list(config.drives),
        camera=config.camera,
        stride=config.stride,
        follow=config.follow,
        patience_s=config.patience_s,
        bag=BagSettings(
            camera_topic=config.camera_topic,
            lidar_topic=config.lidar_topic,
            info_topic=config.info_topic,
            extrinsic=None if config.extrinsic is None else Path(config.extrinsic).expanduser(),
            tolerance_s=config.tolerance_s,
            offset_s=config.offset_s,
        ),
    )
