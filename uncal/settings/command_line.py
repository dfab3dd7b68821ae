"""Words of a command line that Hydra's grammar refuses although a person can read them."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.refusals import refused_options
from uncal.system.output import outlive_readers


def quote_arguments() -> None:
    """Make this process's arguments readable for Hydra, and its output ready; before ``main()``.

    Raises:
        SystemExit: a word is no option and no setting; exit code 2 after a sentence.
    """
    outlive_readers()
    # Python reads settings up to the first option only; -m may stand anywhere.
    sys.argv[1:] = sorted(sys.argv[1:], key=lambda word: word not in ("-m", "--multirun"))
    refused = refused_options(sys.argv[1:])
    if refused is not None:
        sys.stderr.write(f"{refused}\n")
        raise SystemExit(2)
    sys.argv[1:] = readable(sys.argv[1:], Path(CONFIG_DIR))


def readable(words: Iterable[str], groups: Path) -> list[str]:
    """What a person means, in Hydra's words: quotes where it needs them, ``~`` for no group."""
    return [_without_group(word, groups) for word in quoted(words)]


def quoted(words: Iterable[str]) -> list[str]:
    """Quote the values that are one text to a shell but not to Hydra, such as a path with a =.

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


def _without_group(word: str, groups: Path) -> str:
    # Of a group Hydra refuses null with a traceback; of a key it takes it.
    key, _, value = word.partition("=")
    is_group = re.fullmatch(r"\w+(/\w+)*", key) is not None and (groups / key).is_dir()
    return f"~{key}" if is_group and value.lower() == "null" else word


def _is_read(word: str) -> bool:
    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return False
    return True
