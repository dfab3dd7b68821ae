"""What Hydra says of a command line that it refuses, put into one sentence with a remedy."""

from __future__ import annotations

import argparse
import difflib
import re
from collections.abc import Iterator, Sequence

from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

_OVERRIDE = re.compile(r"Could not override '([^']+)'")
_THERE = re.compile(r"Could not append to config\. An item is already at '([^']+)'")
_LISTED = re.compile(r"Multiple values for ([\w/@]+)")
_GONE = re.compile(r"Could not delete (?:from config\. )?'([^']+)'")
_AMBIGUOUS = re.compile(r"Ambiguous value for argument '([^=]+)=(.+?)'")
_SWEPT = re.compile(r"Sweep parameters '([^']+)' requires --multirun")


def refusal(error: HydraException | OmegaConfBaseException, groups: Sequence[str] = ()) -> str:
    """One sentence for what Hydra raises before a job starts.

    Args:
        error: as Hydra raised it; an error of ours has its sentence already.
        groups: names of the configuration groups, such as model/backbone.

    >>> refusal(OverrideParseException("mcd.passes", "missing EQUAL at '<EOF>'"))
    'mcd.passes: cannot be read as a setting; write key=value (mcd.passes=…) without spaces, in \
quotes where the value has commas, brackets or spaces of its own; --help shows how'
    """
    text = str(error).strip()
    if isinstance(error, OmegaConfBaseException):
        return f"{error.full_key or 'the configuration'}: {text.splitlines()[0]}"
    if isinstance(error, OverrideParseException):
        return _unreadable(error.override)
    if isinstance(error, MissingConfigException) and error.missing_cfg_file is not None:
        return _no_option(error.missing_cfg_file, error.options or ())
    for pattern, sentence in (
        (_THERE, "{0}: the key is there already; write {0}=… without the +"),
        (_LISTED, "{0}: one option is chosen already; write {0}=… without the +, and once"),
        (_GONE, "~{0}: there is no such key; leave it out"),
        (_AMBIGUOUS, "{0}={1}: several values; -m runs each in turn, {0}=[{1}] is one list"),
        (_SWEPT, "{0}: several values; -m runs each in turn"),
    ):
        found = pattern.match(text)
        if found is not None:
            return sentence.format(*found.groups())
    found = _OVERRIDE.match(text)
    if found is not None:
        return _no_group(found[1], groups) if "/" in found[1] else _no_key(found[1], error)
    return " ".join(_said(text))


def refused_options(words: Sequence[str]) -> str | None:
    """One sentence for a word that is neither an option nor a setting; None where there is none.

    Args:
        words: of the command line.

    >>> refused_options(["--epochs", "3"])
    '--epochs: no such option; settings are key=value without dashes, such as \
trainer.max_epochs=3, and --help lists them'
    >>> refused_options(["-m", "mcd.passes=5,10"])
    """
    for word in words:
        if word.startswith("="):
            return _unreadable(word)
    parser = get_args_parser()
    parser.exit_on_error = False
    try:
        given, unknown = parser.parse_known_args(list(words))
    except argparse.ArgumentError as error:
        return f"{error}; --help shows how"
    if not unknown:
        tasks = [given.run, given.multirun, given.cfg, given.info, given.shell_completion]
        if sum(map(bool, tasks)) > 1:
            return "--run, --multirun, --cfg, --info, --shell-completion: give one of them"
        if given.resolve and not given.cfg:
            return "--resolve: belongs to --cfg job"
        return None
    return (
        f"{unknown[0]}: no such option; settings are key=value without dashes, such as "
        "trainer.max_epochs=3, and --help lists them"
    )


def _unreadable(word: str) -> str:
    key = re.match(r"[\w./+~@-]*", word)
    return (
        f"{word}: cannot be read as a setting; write key=value ({(key and key[0]) or 'key'}=…) "
        "without spaces, in quotes where the value has commas, brackets or spaces of its own; "
        "--help shows how"
    )


def _no_option(path: str, options: Sequence[str]) -> str:
    group, _, option = path.rpartition("/")
    if not group:
        return f"{option}: there is no such configuration; leave out --config-name"
    word = f"{'+' if group == 'sweeps' else ''}{group}"
    close = difflib.get_close_matches(option, options, 1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{word}={option}: no such option; {hint}there are {', '.join(options) or 'none'}"


def _no_group(group: str, groups: Sequence[str]) -> str:
    close = difflib.get_close_matches(group, groups, 1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{group}: no such group; {hint}--help lists them"


def _no_key(key: str, error: HydraException) -> str:
    """Of a key that the configuration lacks, with the nearest one that it has."""
    cause = error.__cause__
    names = list(_names_around(cause)) if isinstance(cause, OmegaConfBaseException) else []
    if not key.startswith("hydra"):
        names = [name for name in names if name.partition(".")[0] != "hydra"]
    group, _, last = key.rpartition(".")
    beside = [name for name in names if name.rpartition(".")[0] == group]
    close = _called_like(last, beside, 0.6) or _called_like(last, names, 0.7)
    if close:
        return f"{key}: nothing reads this key; did you mean {close[0]}?"
    if beside:
        known = ", ".join(sorted(name.rpartition(".")[2] for name in beside))
        return f"{key}: nothing reads this key; {group or 'the configuration'} has {known}"
    return f"{key}: nothing reads this key; --help lists the groups, and --cfg job every key"


def _called_like(last: str, names: Sequence[str], cutoff: float) -> list[str]:
    """The key whose name, without those of its groups, is nearest; or none."""
    endings = {name.rpartition(".")[2]: name for name in reversed(names)}
    return [endings[name] for name in difflib.get_close_matches(last, endings, 1, cutoff)]


def _names_around(cause: OmegaConfBaseException) -> Iterator[str]:
    node = cause.parent_node
    if node is None:
        return
    root = node._get_root()
    if isinstance(root, DictConfig):
        yield from _keys(root, "")


def _keys(node: DictConfig, path: str) -> Iterator[str]:
    for name in node:
        here = ".".join(filter(None, (path, str(name))))
        yield here
        value = None if OmegaConf.is_missing(node, name) else node._get_node(name)
        if isinstance(value, DictConfig) and not value._is_none():
            yield from _keys(value, here)


def _said(text: str) -> Iterator[str]:
    """The lines of a message up to where Hydra lists folders."""
    for line in text.splitlines():
        if line.strip().lower().endswith(("search path:", "searching in:")):
            return
        if line.strip():
            yield line.strip()
