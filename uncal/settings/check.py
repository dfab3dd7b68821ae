"""Every setting of a run, checked before anything is read, simulated or trained."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import cast

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uncal.errors import ConfigurationError
from uncal.settings.annotations import annotation_of, conforms, described
from uncal.settings.bounds import SIZES, bounds_of
from uncal.settings.guard import task_words
from uncal.settings.readers import Tree, refuse_unread
from uncal.settings.rules import like
from uncal.settings.shipped import shipped_for_this_job

NEEDED: Mapping[str, str] = {
    "callbacks.report": "the run has no result without it",
    "callbacks.uncertainty": "the intervals have no uncertainty calibration without it",
    "callbacks.checkpoint": "nothing would be kept of the training",
}
"""Callbacks that no run can do without, where the shipped configuration has them."""

NULLABLE: tuple[str, ...] = ("logger", "model.start")
"""Groups that a run can do without, beside those that are one of several by name."""

_OF_HYDRA = re.compile(r"\$\{(hydra|now):")
_ITS_OWN = re.compile(r"(^|\.)simulation\.")
"""Keys that the classes of their group check themselves."""


def check_settings(config: DictConfig) -> None:
    """Refuse keys that nothing reads and values out of their bounds.

    Within a job of Hydra the shipped configuration says which keys there are and of what kind
    their values are; elsewhere only the bounds count.

    Raises:
        ConfigurationError: one line for every key at fault.
    """
    shipped = shipped_for_this_job()
    if shipped is not None:
        refuse_unread(config, shipped)
        refuse_removed(task_words(), shipped)
    refuse_values(config, shipped)


def refuse_values(config: DictConfig, shipped: DictConfig | None) -> None:
    """Refuse values out of their bounds, or of another kind than those that ship.

    Raises:
        ConfigurationError: names key, value and what was expected, a line for each.
    """
    defaults = {} if shipped is None else dict(_values(_plain(shipped), ""))
    wrong = [
        line
        for key, raw in _values(_plain(config), "")
        if not _ITS_OWN.search(key)
        for line in _faults(config, key, raw, defaults, shipped is not None)
    ]
    wrong += _between(config)
    if wrong:
        raise ConfigurationError("\n".join(dict.fromkeys(wrong)))


def refuse_removed(words: Sequence[str], shipped: DictConfig) -> None:
    """Refuse ``~key`` of a key that the run reads.

    What a class takes may have a default of its own; callbacks and the logger may go.

    Raises:
        ConfigurationError: names them.
    """
    wrong = []
    for word in words:
        key = word[1:].partition("=")[0].replace("/", ".")
        if not word.startswith("~") or key == "logger":
            continue
        group = OmegaConf.select(shipped, key.rpartition(".")[0]) if "." in key else None
        of_class = isinstance(group, DictConfig) and "_target_" in group
        named = isinstance(group, DictConfig) and all(map(OmegaConf.is_dict, group.values()))
        if key in NEEDED or not (of_class or named):
            wrong.append(f"{word}: the run reads {key}; leave it, or give it another value")
    if wrong:
        raise ConfigurationError("\n".join(wrong))


def _faults(
    config: DictConfig, key: str, raw: object, defaults: Mapping[str, object], known: bool
) -> Iterator[str]:
    default = defaults.get(key)
    if isinstance(raw, str) and (_OF_HYDRA.search(raw) or ("${" in raw and raw == default)):
        return  # as shipped: what it refers to is checked where it stands
    if isinstance(raw, Mapping) and isinstance(default, dict | None):
        return  # a group: its keys are checked one by one
    if raw == "???":
        yield f"{key}: must be given, as {key}=…"
        return
    if default is not None and type(raw) is type(default) and raw == default:
        return
    value = _resolved(config, key)
    if value is None and (default is None or _may_be_null(config, key, default, defaults)):
        return
    if isinstance(default, dict) and not isinstance(value, dict):
        yield f"{key}={_shown(value)}: expected a group of keys ({', '.join(default) or 'none'})"
    elif not isinstance(value, dict) or not isinstance(default, dict | None):
        shipped = _shipped_value(default)
        rule = bounds_of(key) or like(shipped, SIZES if key.startswith("model.") else None)
        if rule is not None and not rule.holds(value):
            hint = "" if shipped is None else f"; the default is {_shown(shipped)}"
            yield f"{key}={_shown(value)}: expected {rule.expected}{hint}"
        elif rule is None and known:
            yield from _by_annotation(config, key, value)


def _by_annotation(config: DictConfig, key: str, value: object) -> Iterator[str]:
    """Of a keyword that a user has added for a class that takes it."""
    group, _, name = key.rpartition(".")
    target = _target(config, group)
    if target is None or name.startswith("_"):
        return
    annotation = annotation_of(target, name)
    if not conforms(value, annotation):
        yield f"{key}={_shown(value)}: {target} expects {described(annotation)}"


def _may_be_null(
    config: DictConfig, key: str, default: object, defaults: Mapping[str, object]
) -> bool:
    group, _, name = key.rpartition(".")
    if isinstance(default, dict):
        # One of several groups by name, such as callbacks.
        beside = [v for k, v in defaults.items() if k.rpartition(".")[0] == group]
        named = bool(group) and all(isinstance(value, dict) for value in beside)
        holds_named = bool(default) and all(isinstance(v, dict) for v in default.values())
        return key not in NEEDED and (named or key in NULLABLE or (holds_named and not _needs(key)))
    rule = bounds_of(key)
    if rule is not None:
        return rule.holds(None)
    target = _target(config, group)
    if target is None:
        return False
    annotation = annotation_of(target, name)
    return annotation is not None and "None" in described(annotation)


def _needs(group: str) -> bool:
    """Whether something in a group is needed."""
    return any(name.startswith(f"{group}.") for name in NEEDED)


def _between(config: DictConfig) -> Iterator[str]:
    """What one setting says of another."""
    for name, reason in NEEDED.items():
        group, _, last = name.partition(".")
        callbacks = config.get(group)
        if isinstance(callbacks, DictConfig) and last in callbacks and callbacks[last] is None:
            yield f"{name}=null: {reason}; leave it as it is"
    if _resolved(config, "trainer.fast_dev_run"):
        yield (
            "trainer.fast_dev_run: keeps no checkpoint, which a table is made with; a short run is "
            "trainer.max_epochs=1 trainer.limit_train_batches=2"
        )
    fractions = _resolved(config, "split.fractions")
    if isinstance(fractions, list) and len(fractions) == 4:
        others_test = _resolved(config, "split.test") == "unseen"
        others_test = others_test or _resolved(config, "split.test_drives") is not None
        used = fractions[:3] if others_test else fractions
        if any(fraction == 0 for fraction in used):
            yield (
                f"split.fractions={fractions}: training, validation, uncertainty calibration and "
                "test each need a share above 0 (the test none with split.test=unseen or "
                "split.test_drives)"
            )


def _resolved(config: DictConfig, key: str) -> object:
    """A value with what it refers to put in."""
    try:
        value = OmegaConf.select(config, key)
        return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
    except OmegaConfBaseException as error:
        reason = str(error).splitlines()[0]
        raise ConfigurationError(f"{key}: {reason}; write ${{a.key}} that is there") from error


def _target(config: DictConfig, group: str) -> str | None:
    node = OmegaConf.select(config, group) if group else config
    target = node.get("_target_") if isinstance(node, DictConfig) else None
    return target if isinstance(target, str) else None


def _values(node: Tree, path: str) -> Iterator[tuple[str, object]]:
    """Every key, groups before what is in them."""
    for name, value in node.items():
        here = f"{path}.{name}" if path else str(name)
        yield here, value
        if isinstance(value, Mapping):
            yield from _values(cast(Tree, value), here)


def _shipped_value(default: object) -> object:
    """A default that a rule can be made of; none where it only refers to another."""
    return None if isinstance(default, str) and "${" in default else default


def _plain(config: DictConfig) -> Tree:
    return cast(Tree, OmegaConf.to_container(config, resolve=False))


def _shown(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if value == "" else str(value)
