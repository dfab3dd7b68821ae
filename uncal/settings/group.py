"""Groups of settings that check themselves when they are made, by the rules of their fields."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import ClassVar, TypeVar, cast, get_args, get_type_hints

from uncal.errors import ConfigurationError
from uncal.settings.rules import require

GroupT = TypeVar("GroupT", bound="SettingsGroup")


@dataclass(frozen=True)
class SettingsGroup:
    """Base of frozen dataclasses; a field ``Annotated[float, number(0, 1)]`` is checked."""

    key: ClassVar[str]  # dotted name of the group in the configuration, for messages

    def __post_init__(self) -> None:
        """Check every field that has a rule.

        Raises:
            ConfigurationError: names the key, its value and what was expected.
        """
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            for rule in getattr(hint, "__metadata__", ()):
                require(f"{self.key}.{name}", getattr(self, name), rule)

    def require_order(self, lower: str, upper: str) -> None:
        """Raise unless the field ``lower`` is smaller than the field ``upper``."""
        if not getattr(self, lower) < getattr(self, upper):
            raise ConfigurationError(
                f"{self.key}.{lower}={getattr(self, lower)}: expected less than "
                f"{self.key}.{upper}, which is {getattr(self, upper)}"
            )

    @classmethod
    def from_mapping(cls: type[GroupT], mapping: Mapping[str, object]) -> GroupT:
        """Build the group from a mapping; nested groups are mappings themselves.

        Raises:
            ConfigurationError: a key is unknown or missing, or a value breaks its rule.
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
        if missing := [f"{cls.key}.{name}" for name in needed if name not in mapping]:
            raise ConfigurationError(
                f"missing setting {', '.join(missing)}; conf/simulation/street.yaml (events: "
                "event_street.yaml, motion: motion/step.yaml) lists every key with its unit"
            )
        return cls(**{k: _converted(f"{cls.key}.{k}", hints[k], v) for k, v in mapping.items()})


def _converted(key: str, expected: type, value: object) -> object:
    """A YAML value in the field's type: groups made, whole numbers exact."""
    if type(None) in get_args(expected):
        if value is None:
            return None
        expected = get_args(expected)[0]
    if issubclass(expected, SettingsGroup):
        if not isinstance(value, Mapping):
            raise ConfigurationError(f"{key}={value!r}: expected a group of keys")
        return expected.from_mapping(cast(Mapping[str, object], value))
    if isinstance(value, int | float) and not isinstance(value, bool):
        if expected is float:
            return float(value)
        if expected is int and float(value).is_integer():
            return int(value)
    return value
