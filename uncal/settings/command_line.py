"""Words of a command line that Hydra's grammar refuses although a person can read them."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException


def quote_arguments() -> None:
    """Put quotes into this process's arguments where Hydra needs them; before ``main()``."""
    sys.argv[1:] = quoted(sys.argv[1:])


def quoted(words: Iterable[str]) -> list[str]:
    """Quote the values that are one text to a shell but not to Hydra, such as a path with a =.

    Args:
        words: of the command line.

    >>> quoted(["-m", "ckpt=out/a=1 b/best.ckpt", "seed=0,1"])
    ['-m', 'ckpt="out/a=1 b/best.ckpt"', 'seed=0,1']
    """
    return [_quoted(word) for word in words]


def _quoted(word: str) -> str:
    key, equals, value = word.partition("=")
    if word.startswith("-") or not equals or not value or _is_read(word):
        return word
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    candidate = f'{key}="{escaped}"'
    return candidate if _is_read(candidate) else word


def _is_read(word: str) -> bool:
    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return False
    return True
