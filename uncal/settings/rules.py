"""What a single setting may be: numbers within bounds, words, lists of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from uncal.errors import ConfigurationError

LARGEST = 1e9
"""Beyond it a setting without bounds of its own is a slip of the keyboard."""


@dataclass(frozen=True)
class Rule:
    """What a setting may be."""

    expected: str  # for messages, after "expected"
    holds: Callable[[object], bool]  # whether a value is that


def require(key: str, value: object, rule: Rule) -> None:
    """Refuse a value that breaks a rule.

    Raises:
        ConfigurationError: names key, value and what was expected.

    >>> require("mcd.passes", 0, number(1, 10, whole=True))
    Traceback (most recent call last):
    uncal.errors.ConfigurationError: mcd.passes=0: expected a whole number from 1 to 10
    """
    if not rule.holds(value):
        raise ConfigurationError(f"{key}={value!r}: expected {rule.expected}")


def number(
    low: float, high: float, *, whole: bool = False, above: bool = False, below: bool = False
) -> Rule:
    """A finite number from ``low`` to ``high``; ``above``, ``below``: these excluded; no booleans.

    >>> number(0, 1, below=True).holds(1.0), number(0, 1, below=True).expected
    (False, 'a number of at least 0 and below 1')
    >>> number(1, 9, whole=True).holds(1.5), number(1, 9, whole=True).expected
    (False, 'a whole number from 1 to 9')
    """

    def holds(value: object) -> bool:
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
            return False
        over = value > low if above else value >= low
        return math.isfinite(value) and over and (value < high if below else value <= high)

    kind = "a whole number" if whole else "a number"
    if not (above or below):
        return Rule(f"{kind} from {low:.15g} to {high:.15g}", holds)
    lowest = f"above {low:g}" if above else f"of at least {low:g}"
    highest = f"below {high:g}" if below else f"up to {high:g}"
    return Rule(f"{kind} {lowest} and {highest}", holds)


def words(*known: str) -> Rule:
    """One of a few words.

    >>> words("a", "b").holds("c"), words("a", "b").expected
    (False, 'a or b')
    """
    return Rule(" or ".join(known), lambda value: isinstance(value, str) and value in known)


TEXT = Rule(
    "text that is not empty (put a number in quotes)",
    lambda value: isinstance(value, str) and bool(value.strip()),
)

FLAG = Rule("true or false", lambda value: isinstance(value, bool))


def listed(
    each: Rule,  # what every entry must be
    length: int | None = None,  # how many entries; None: one or more
    *,
    rising: bool = False,  # whether every entry must be larger than the one before
    distinct: bool = False,  # whether no entry may come twice
    total: float | None = None,  # what they add up to; None: anything
) -> Rule:
    """A list.

    >>> listed(number(0, 1), 2, rising=True).holds([0.9, 0.1])
    False
    """

    def holds(value: object) -> bool:
        return (
            isinstance(value, list)
            and bool(value)
            and all(map(each.holds, value))
            and len(value) == (length or len(value))
            and not (distinct and len(set(value)) < len(value))
            and (total is None or abs(math.fsum(value) - total) <= 1e-6)
            and not (rising and any(a >= b for a, b in pairwise(value)))
        )

    expected = f"a list of {length or 'one or more'}, each {each.expected}"
    expected += ", rising" * rising + ", all different" * distinct
    return Rule(expected if total is None else f"{expected}, that sum to {total:g}", holds)


def either(*rules: Rule | None) -> Rule:
    """What one of several rules expects; ``None`` in their place allows null."""
    known = [Rule("null", lambda value: value is None) if rule is None else rule for rule in rules]
    return Rule(
        " or ".join(rule.expected for rule in known),
        lambda value: any(rule.holds(value) for rule in known),
    )


def like(shipped: object, whole: Rule | None = None) -> Rule | None:
    """A rule for a setting that has no other: of the kind of the shipped value.

    Args:
        shipped: value.
        whole: of whole numbers; None: any.

    Returns:
        None where it says nothing: null, an empty text, a group.

    >>> like(0.5).holds("a"), like([1, 2]).holds([3]), like(None)
    (False, True, None)
    """
    if isinstance(shipped, bool):
        return FLAG
    if isinstance(shipped, int):
        return whole or number(-LARGEST, LARGEST, whole=True)
    if isinstance(shipped, float):
        return number(-LARGEST, LARGEST)
    if isinstance(shipped, str):
        return TEXT if shipped else None
    if isinstance(shipped, list) and shipped:
        first = next((entry for entry in shipped if isinstance(entry, float)), shipped[0])
        each = like(first, whole)
        return None if each is None else listed(each)
    return None
