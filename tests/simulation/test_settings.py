from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from uncal.errors import ConfigurationError
from uncal.simulation import settings as settings_module
from uncal.simulation.settings import LidarSettings, SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def test_yaml_has_every_key_and_converts_numbers(make_settings: MakeSettings) -> None:
    settings = make_settings(camera={"focal_px": 70}, n_rigs=3.0)
    assert settings.camera.focal_px == 70.0
    assert isinstance(settings.camera.focal_px, float)
    assert settings.n_rigs == 3
    assert isinstance(settings.n_rigs, int)
    assert settings.n_frames == 3 * 1 * 3


def test_settings_survive_a_round_trip(tiny_settings: SimulationSettings) -> None:
    assert SimulationSettings.from_mapping(tiny_settings.as_dict()) == tiny_settings


def test_unknown_key_is_named_with_the_closest_one(make_settings: MakeSettings) -> None:
    with pytest.raises(ConfigurationError, match=r"simulation\.lidar\.beamz.*lidar\.beams\?"):
        make_settings(lidar={"beamz": 3})


def test_missing_keys_are_named(tiny_settings: SimulationSettings) -> None:
    plain = tiny_settings.as_dict()
    del plain["seed"]
    with pytest.raises(ConfigurationError, match=r"missing setting simulation\.seed"):
        SimulationSettings.from_mapping(plain)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"n_rigs": 0}, r"simulation\.n_rigs=0: expected a whole number from 1 to 3652"),
        ({"n_rigs": 2.5}, r"simulation\.n_rigs=2\.5: expected a whole number"),
        ({"seed": "abc"}, r"simulation\.seed='abc': expected a whole number"),
        ({"camera": {"shadows": 1}}, r"simulation\.camera\.shadows=1: expected true or false"),
        ({"camera": {"vignetting": 1.5}}, r"camera\.vignetting=1\.5: expected a number from 0"),
        ({"camera": {"focal_px": True}}, r"camera\.focal_px=True: expected a number"),
        ({"lidar": {"elevation_min_deg": 5.0}}, r"elevation_min_deg=5\.0: expected less"),
        ({"lidar": {"range_max_m": 1.2}}, r"range_min_m=1\.5: expected less than.*1\.2"),
        ({"rig": {"rotation_deg": float("nan")}}, r"rotation_deg=nan: expected a number from"),
    ],
)
def test_bad_values_are_named_with_their_bound(
    make_settings: MakeSettings, overrides: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make_settings(**overrides)


def test_group_must_be_a_mapping(tiny_settings: SimulationSettings) -> None:
    plain = {**tiny_settings.as_dict(), "lidar": 64}
    with pytest.raises(ConfigurationError, match=r"simulation\.lidar=64: expected a group"):
        SimulationSettings.from_mapping(plain)


def test_one_beam_needs_no_elevation_range(tiny_settings: SimulationSettings) -> None:
    one: LidarSettings = replace(
        tiny_settings.lidar, beams=1, elevation_min_deg=0.0, elevation_max_deg=0.0
    )
    assert one.beams == 1


def test_fingerprint_follows_settings_and_version(
    make_settings: MakeSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    fingerprint = make_settings().fingerprint()
    assert make_settings().fingerprint() == fingerprint
    assert make_settings(seed=1).fingerprint() != fingerprint
    assert make_settings(scene={"view_m": 61.0}).fingerprint() != fingerprint
    monkeypatch.setattr(settings_module, "VERSION", settings_module.VERSION + 1)
    assert make_settings().fingerprint() != fingerprint
