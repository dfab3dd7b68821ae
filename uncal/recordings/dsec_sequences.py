"""The sequences of DSEC by name, and who trains and who tests.

A drive was recorded in one go with one LiDAR file (``zurich_city_04``); DSEC cuts it into
sequences (``zurich_city_04_a`` ... ``_f``).
"""

from __future__ import annotations

import re


def _named(letters_of_drive: dict[str, str]) -> tuple[str, ...]:
    return tuple(f"{drive}_{x}" for drive, letters in letters_of_drive.items() for x in letters)


TRAIN: tuple[str, ...] = _named(
    {
        "thun_00": "a",
        "interlaken_00": "cdefg",
        "zurich_city_00": "ab",
        "zurich_city_01": "abcdef",
        "zurich_city_02": "abcde",
        "zurich_city_03": "a",
        "zurich_city_04": "abcdef",
        "zurich_city_05": "ab",
        "zurich_city_06": "a",
        "zurich_city_07": "a",
        "zurich_city_08": "a",
        "zurich_city_09": "abcde",
        "zurich_city_10": "ab",
        "zurich_city_11": "abc",
    }
)
"""The official training sequences."""

TEST: tuple[str, ...] = _named(
    {
        "thun_01": "ab",
        "interlaken_00": "ab",
        "interlaken_01": "a",
        "zurich_city_12": "a",
        "zurich_city_13": "ab",
        "zurich_city_14": "abc",
        "zurich_city_15": "a",
    }
)
"""The official test sequences; interlaken_00 was driven once and is in both lists."""

_LETTER = re.compile(r"(.+)_[a-z]")


def drive_of(sequence: str) -> str:
    """The drive that a sequence is a part of: its name without the letter.

    >>> drive_of("zurich_city_04_a")
    'zurich_city_04'
    """
    match = _LETTER.fullmatch(sequence)
    return match[1] if match else sequence
