"""What all groups of simulator settings share: bounds, conversion, messages that name the key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import ClassVar, TypeVar, cast, get_args, get_type_hints

from uncal.errors import ConfigurationError

GroupT = TypeVar("GroupT", bound="SettingsGroup")


@dataclass(frozen=True)
class Within:
    """Bounds of a setting, both allowed; an annotation of its field."""

    low: float
    high: float


@dataclass(frozen=True)
class SettingsGroup:
    """A group of settings that checks its own bounds and can be built from a mapping."""

    key: ClassVar[str] = "simulation"

    def __post_init__(self) -> None:
        """Check every bounded field.

        Raises:
            ConfigurationError: names the key, its value and the bound.
        """
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            for bound in getattr(hint, "__metadata__", ()):
                value = getattr(self, name)
                if not bound.low <= value <= bound.high:
                    raise ConfigurationError(
                        f"{self.key}.{name} is {value}; it must lie between {bound.low} and "
                        f"{bound.high}"
                    )

    def require_order(self, lower: str, upper: str) -> None:
        """Raise unless the field ``lower`` is smaller than the field ``upper``."""
        if not getattr(self, lower) < getattr(self, upper):
            raise ConfigurationError(
                f"{self.key}.{lower} is {getattr(self, lower)}; it must be smaller than "
                f"{self.key}.{upper}, which is {getattr(self, upper)}"
            )

    @classmethod
    def from_mapping(cls: type[GroupT], mapping: Mapping[str, object]) -> GroupT:
        """Build the group from a plain or OmegaConf mapping.

        Args:
            mapping: exactly the keys of this class, less those that have a default; nested groups
                are mappings themselves.

        Raises:
            ConfigurationError: a key is unknown or missing, or a value has the wrong type or lies
                out of bounds.
        """
        hints = get_type_hints(cls)
        names = [item.name for item in fields(cls)]
        for key in mapping:
            if key not in names:
                close = difflib.get_close_matches(str(key), names, n=1)
                hint = f"; did you mean {cls.key}.{close[0]}?" if close else ""
                raise ConfigurationError(
                    f"unknown setting {cls.key}.{key}{hint} Known here: {', '.join(names)}"
                )
        needed = [item.name for item in fields(cls) if item.default is MISSING]
        missing = [name for name in needed if name not in mapping]
        if missing:
            raise ConfigurationError(
                f"missing setting {', '.join(f'{cls.key}.{name}' for name in missing)}; "
                "conf/simulation/street.yaml (events: event_street.yaml, motion: motion/step.yaml) "
                "lists every key with its unit"
            )
        given = [name for name in names if name in mapping]
        return cls(**{name: _convert(cls.key, name, hints[name], mapping[name]) for name in given})


def _convert(group: str, name: str, expected: type, value: object) -> object:
    """Turn a YAML value into the field's type without losing anything."""
    alternatives = get_args(expected)
    if type(None) in alternatives:
        if value is None:
            return None
        expected = alternatives[0]
    if issubclass(expected, SettingsGroup):
        if not isinstance(value, Mapping):
            raise ConfigurationError(f"{group}.{name} is {value!r}; it must be a group of keys")
        return expected.from_mapping(cast(Mapping[str, object], value))
    if expected is bool and isinstance(value, bool):
        return value
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if expected is float and is_number:
        return float(cast(float, value))
    if expected is int and is_number and float(cast(float, value)).is_integer():
        return int(cast(float, value))
    kind = {bool: "true or false", int: "a whole number", float: "a number"}[expected]
    raise ConfigurationError(f"{group}.{name} is {value!r}; it must be {kind}")
