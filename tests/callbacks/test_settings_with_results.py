"""TensorBoard's HPARAMS tab has the settings of a run beside its result."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast
from unittest.mock import create_autospec

import pytest
from lightning import Trainer
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
    EventAccumulator,
)
from tensorboard.plugins.hparams.plugin_data_pb2 import (  # type: ignore[import-untyped]
    HParamsPluginData,
)

from uncal.callbacks.settings_with_results import SettingsWithResults
from uncal.models.module import CalibrationModule
from uncal.models.run_state import RunState


def test_settings_and_result_are_in_the_events(tmp_path: Path) -> None:
    module = create_autospec(CalibrationModule, instance=True)
    module.run = RunState(mean_ratio=0.5)
    module.recipe = {"seed": 0, "mcd": {"passes": 25, "layers": None}}
    logger = TensorBoardLogger(str(tmp_path), name="", version="")
    trainer = SimpleNamespace(
        is_global_zero=True,
        loggers=[CSVLogger(str(tmp_path / "csv")), logger],
    )
    SettingsWithResults().teardown(cast(Trainer, trainer), module, "test")
    logger.finalize("success")
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert events.Scalars("result/mean ratio")[-1].value == pytest.approx(0.5)
    start = HParamsPluginData.FromString(
        events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    ).session_start_info
    assert start.hparams["mcd.passes"].number_value == 25
    assert start.hparams["mcd.layers"].string_value == "None"


def test_without_a_result_nothing_is_logged(tmp_path: Path) -> None:
    module = create_autospec(CalibrationModule, instance=True)
    module.run = RunState()
    trainer = SimpleNamespace(is_global_zero=True, loggers=[None])
    SettingsWithResults().teardown(cast(Trainer, trainer), module, "test")
    assert not list(tmp_path.iterdir())
