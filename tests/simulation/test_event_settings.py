from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import cast

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from uncal.errors import ConfigurationError
from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.manifest import layout_of
from uncal.simulation.settings import SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def test_without_events_nothing_is_new(tiny_settings: SimulationSettings) -> None:
    # The manifests and fingerprints of folders simulated before there were events stay valid.
    assert "events" not in tiny_settings.as_dict()
    spelled_out = SimulationSettings.from_mapping({**tiny_settings.as_dict(), "events": None})
    assert spelled_out == tiny_settings
    assert spelled_out.fingerprint() == tiny_settings.fingerprint()
    assert layout_of(tiny_settings).folders(0) == ["2041_01_01"]


def test_events_survive_a_round_trip_and_count(make_event_settings: MakeSettings) -> None:
    settings = make_event_settings()
    assert SimulationSettings.from_mapping(settings.as_dict()) == settings
    assert layout_of(settings).folders(12) == ["data/sim_0012", "sim_0012_a"]
    fingerprints = {
        settings.fingerprint(),
        replace(settings, events=None).fingerprint(),
        make_event_settings(events={"noise_hz": 3.0}).fingerprint(),
    }
    assert len(fingerprints) == 3


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            {"events": {"subframes": 0}},
            r"events\.subframes=0: expected a whole number from 1",
        ),
        ({"events": {"threshold": 0.2}}, r"unknown setting simulation\.events\.threshold"),
        ({"events": {"window_ms": 500.0}}, r"window_ms is 500\.0; it must not be longer than"),
        ({"drives_per_rig": 27}, r"drives_per_rig is 27; with simulation\.events at most 26"),
        ({"frames_per_drive": 5000}, r"frames_per_drive is 5000; with .* at most 4500 fit"),
        ({"events": 3}, r"simulation\.events=3: expected a group of keys"),
    ],
)
def test_bad_values_are_named_with_their_bound(
    make_event_settings: MakeSettings, overrides: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make_event_settings(**overrides)


def test_a_missing_key_is_named(make_event_settings: MakeSettings) -> None:
    plain = make_event_settings().as_dict()
    events = plain["events"]
    assert isinstance(events, dict)
    del events["dark"]
    with pytest.raises(ConfigurationError, match=r"events\.dark; .*event_street\.yaml.*\) lists"):
        SimulationSettings.from_mapping(plain)


def test_the_command_line_has_and_explains_the_event_street() -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("simulate", overrides=["simulation=event_street"])
    plain = OmegaConf.to_container(config.simulation, resolve=True)
    settings = SimulationSettings.from_mapping(cast(Mapping[str, object], plain))
    assert settings.events is not None
    assert settings.lidar.beams == 16
    assert settings.camera.focal_px == 230.0
    explained = (Path(CONFIG_DIR) / "simulate.yaml").read_text()
    assert [item.name for item in fields(settings.events) if item.name not in explained] == []
