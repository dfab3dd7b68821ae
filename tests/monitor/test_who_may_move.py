"""References of simulated rigs alone do not entitle a monitor to move the extrinsic in use."""

from __future__ import annotations

from dataclasses import replace

import pytest

from uncal.monitor.monitor import Monitor
from uncal.monitor.settings import MonitorSettings


@pytest.mark.parametrize("told", [None, True, False])
@pytest.mark.parametrize("label", ["simulated: data/rigs", "data/mine"])
def test_by_default_only_references_of_real_recordings_move_it(
    told: bool | None, label: str
) -> None:
    shipped = Monitor("unical")
    assert shipped.references is not None
    assert shipped.references.label.startswith("simulated: ")
    settings = MonitorSettings.shipped()
    settings = replace(settings, update=replace(settings.update, apply=told))
    references = replace(shipped.references, label=label)
    monitor = Monitor("unical", references=references, settings=settings)
    expected = label == "data/mine" if told is None else told
    assert monitor.settings.update.apply is expected
    assert any("update.apply=true" in note for note in monitor.notes) == (label != "data/mine")
