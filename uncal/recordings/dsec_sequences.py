"""The sequences of DSEC by name, and who trains and who tests.

A drive was recorded in one go with one LiDAR file (``zurich_city_04``); DSEC cuts it into
sequences (``zurich_city_04_a`` ... ``_f``).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from uncal.errors import ConfigurationError


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


@dataclass(frozen=True)
class SequenceSplit:
    """Who trains and who tests.

    Attributes:
        training: sequences whose frames are shared out among training, validation and uncertainty
            calibration (the paper: 70/15/15).
        test: sequences of the separate test set; none of them is in ``training``.
        note: one or two sentences for the report, saying what was done.
    """

    training: tuple[str, ...]
    test: tuple[str, ...]
    note: str


def paper_split(with_lidar: Iterable[str], held_out: float, seed: int) -> SequenceSplit:
    """The paper's split of DSEC: the official test sequences test, the others train.

    Nothing can be tested on a sequence without LiDAR. Where that leaves no official test sequence,
    whole drives of the training sequences are held out instead: frames of one drive share the
    street, the light and the extrinsic.

    Args:
        with_lidar: names of the sequences that have frames. Names in neither official list (a
            simulated stand-in) count as training sequences.
        held_out: share of the training sequences to hold out where there is no official test
            sequence, in (0, 1); rounded up to whole drives.
        seed: another seed, other drives held out.

    Returns:
        The split.

    Raises:
        ConfigurationError: ``held_out`` is out of range, or there is nothing to train on or to
            hold out.

    >>> paper_split(["thun_00_a", "thun_01_a"], held_out=0.15, seed=0).test
    ('thun_01_a',)
    """
    if not 0 < held_out < 1:
        raise ConfigurationError(f"held_out is {held_out}, expected a share in (0, 1), say 0.15.")
    names = sorted(set(with_lidar))
    test = tuple(name for name in names if name in TEST)
    training = tuple(name for name in names if name not in TEST)
    if not training:
        raise ConfigurationError(
            f"No training sequence among {', '.join(names) or 'none'}; add one of the official "
            f"ones, such as {TRAIN[0]}, or use split.by=drive."
        )
    if test:
        return SequenceSplit(training, test, _official_note(training, test))
    return _hold_out(training, held_out, seed)


def _hold_out(training: tuple[str, ...], share: float, seed: int) -> SequenceSplit:
    drives = sorted(set(map(drive_of, training)), key=lambda drive: _hash(seed, drive))
    if len(drives) < 2:
        raise ConfigurationError(
            f"There is no official test sequence with LiDAR, and the training sequences "
            f"({', '.join(training)}) are all of the drive {drives[0]}, so that none can be held "
            "out: add another drive, or use split.by=frame."
        )
    test: list[str] = []
    for drive in drives[:-1]:
        if len(test) >= share * len(training):
            break
        test += [name for name in training if drive_of(name) == drive]
    left = tuple(name for name in training if name not in test)
    held = sorted(set(map(drive_of, test)))
    return SequenceSplit(
        left,
        tuple(sorted(test)),
        "No official test sequence with LiDAR: the test set is "
        f"{len(held)} whole drive(s) held out of the training ones ({', '.join(held)}).",
    )


def _official_note(training: Sequence[str], test: Sequence[str]) -> str:
    note = f"Test set: the {len(test)} official test sequence(s) with LiDAR ({', '.join(test)})."
    if both := sorted(set(map(drive_of, training)) & set(map(drive_of, test))):
        note += f" Of the drive(s) {', '.join(both)}, other parts are in training."
    return note


def _hash(seed: int, name: str) -> bytes:
    return hashlib.blake2b(f"{seed}:{name}".encode(), digest_size=16).digest()
