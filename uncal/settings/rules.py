"""What a single setting may be: numbers within bounds, words, lists of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol


class Rule(Protocol):
    """Says what it expects, and whether a value is that."""

    def holds(self, value: object) -> bool:
        """Whether the value is what is expected."""

    def expected(self) -> str:
        """For messages: expected …."""


@dataclass(frozen=True)
class Number:
    """A finite number.

    Attributes:
        low: smallest.
        high: largest.
        whole: whether it must be a whole number.
        above: whether ``low`` itself is excluded.
        below: whether ``high`` itself is excluded.

    >>> Number(0, 1, below=True).holds(1.0), Number(0, 1, below=True).expected()
    (False, 'a number of at least 0 and below 1')
    >>> Number(1, 9, whole=True).holds(1.5), Number(1, 9, whole=True).expected()
    (False, 'a whole number from 1 to 9')
    """

    low: float
    high: float
    whole: bool = False
    above: bool = False
    below: bool = False

    def holds(self, value: object) -> bool:
        """Whether the value is such a number; true and false are none."""
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            return False
        if not math.isfinite(value):
            return False
        over = value > self.low if self.above else value >= self.low
        return over and (value < self.high if self.below else value <= self.high)

    def expected(self) -> str:
        """For messages."""
        kind = "a whole number" if self.whole else "a number"
        if not (self.above or self.below):
            return f"{kind} from {self.low:.15g} to {self.high:.15g}"
        low = f"above {self.low:g}" if self.above else f"of at least {self.low:g}"
        high = f"below {self.high:g}" if self.below else f"up to {self.high:g}"
        return f"{kind} {low} and {high}"


@dataclass(frozen=True)
class Words:
    """One of a few words.

    >>> Words("a", "b").holds("c"), Words("a", "b").expected()
    (False, 'a or b')
    """

    words: tuple[str, ...]

    def __init__(self, *words: str) -> None:
        object.__setattr__(self, "words", words)

    def holds(self, value: object) -> bool:
        """Whether the value is one of them."""
        return isinstance(value, str) and value in self.words

    def expected(self) -> str:
        """For messages."""
        return " or ".join(self.words)


@dataclass(frozen=True)
class Text:
    """Text that is not empty."""

    def holds(self, value: object) -> bool:
        """Whether the value is text with something in it."""
        return isinstance(value, str) and bool(value.strip())

    def expected(self) -> str:
        """For messages."""
        return "text that is not empty (put a number in quotes)"


@dataclass(frozen=True)
class Flag:
    """True or false."""

    def holds(self, value: object) -> bool:
        """Whether the value is one of the two."""
        return isinstance(value, bool)

    def expected(self) -> str:
        """For messages."""
        return "true or false"


@dataclass(frozen=True)
class Listed:
    """A list.

    Attributes:
        each: what every entry must be.
        length: how many entries; None: one or more.
        rising: whether every entry must be larger than the one before.
        distinct: whether no entry may come twice.
        total: what they add up to; None: anything.

    >>> Listed(Number(0, 1), 2, rising=True).holds([0.9, 0.1])
    False
    """

    each: Rule
    length: int | None = None
    rising: bool = False
    distinct: bool = False
    total: float | None = None

    def holds(self, value: object) -> bool:
        """Whether the value is such a list."""
        if not isinstance(value, list) or not value or not all(map(self.each.holds, value)):
            return False
        if self.length is not None and len(value) != self.length:
            return False
        if self.distinct and len(set(value)) < len(value):
            return False
        if self.total is not None and abs(math.fsum(value) - self.total) > 1e-6:
            return False
        return not self.rising or all(a < b for a, b in pairwise(value))

    def expected(self) -> str:
        """For messages."""
        many = "one or more" if self.length is None else str(self.length)
        return "".join(
            (
                f"a list of {many}, each {self.each.expected()}",
                ", rising" if self.rising else "",
                ", all different" if self.distinct else "",
                "" if self.total is None else f", that sum to {self.total:g}",
            )
        )


@dataclass(frozen=True)
class Either:
    """What one of several rules expects; ``None`` in their place allows null."""

    rules: tuple[Rule | None, ...]

    def __init__(self, *rules: Rule | None) -> None:
        object.__setattr__(self, "rules", rules)

    def holds(self, value: object) -> bool:
        """Whether one of them does."""
        return any(value is None if rule is None else rule.holds(value) for rule in self.rules)

    def expected(self) -> str:
        """For messages."""
        return " or ".join("null" if rule is None else rule.expected() for rule in self.rules)


def like(shipped: object) -> Rule | None:
    """A rule for a setting that has no other: of the kind of the shipped value.

    Returns:
        None where it says nothing: null, an empty text, a group.

    >>> like(0.5).holds("a"), like([1, 2]).holds([3]), like(None)
    (False, True, None)
    """
    if isinstance(shipped, bool):
        return Flag()
    if isinstance(shipped, int):
        return Number(-LARGEST, LARGEST, whole=True)
    if isinstance(shipped, float):
        return Number(-LARGEST, LARGEST)
    if isinstance(shipped, str):
        return Text() if shipped else None
    if isinstance(shipped, list) and shipped:
        return _like_list(shipped)
    return None


LARGEST = 1e9
"""Beyond it a setting without bounds of its own is a slip of the keyboard."""


def _like_list(shipped: Sequence[object]) -> Rule | None:
    if any(isinstance(entry, float) for entry in shipped):
        return Listed(Number(-LARGEST, LARGEST))
    each = like(shipped[0])
    return None if each is None else Listed(each)
