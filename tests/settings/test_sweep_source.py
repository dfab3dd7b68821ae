"""The sweeps are a group of every entry point, from any folder, and nothing beside them is."""

from __future__ import annotations

from pathlib import Path

from hydra.core.object_type import ObjectType

from uncal.settings.sweep_source import SweepSource, sweeps_parent

ROOT = Path(__file__).parents[2]


def test_a_checkout_has_them_beside_the_package_and_a_wheel_in_it(tmp_path: Path) -> None:
    package = tmp_path / "uncal"
    (package / "sweeps").mkdir(parents=True)
    (package / "sweeps" / "passes.yaml").touch()
    assert sweeps_parent(package) == package
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps" / "passes.yaml").touch()
    assert sweeps_parent(package) == tmp_path


def test_the_wheel_takes_them_along() -> None:
    assert 'sweeps = "uncal/sweeps"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_only_the_sweeps_are_seen() -> None:
    source = SweepSource("uncal", "uncal://sweeps")
    assert source.available()
    assert source.list("", ObjectType.GROUP) == ["sweeps"]
    assert source.list("", ObjectType.CONFIG) == []
    assert {"passes", "split"} <= set(source.list("sweeps", ObjectType.CONFIG))
    assert source.is_group("sweeps/network")
    assert source.is_config("sweeps/passes")
    assert not source.is_group("docs")
    assert not source.is_group("uncal")
    assert not source.is_config("conf/train")
    assert "hydra" in source.load_config("sweeps/passes").config
