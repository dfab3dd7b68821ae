"""Keys that nothing reads, found by what the shipped configuration and the classes in it read."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import cast

from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError

Tree = Mapping[str, object]

_INTERPOLATION = re.compile(r"\$\{([A-Za-z_][\w.]*)\}")
_SPECIAL = ("_target_", "_partial_", "_recursive_", "_convert_", "_args_")
"""What Hydra itself reads beside a ``_target_``."""


def refuse_unread(config: DictConfig, reference: DictConfig) -> None:
    """Refuse keys without a reader.

    A key has one if the reference has it, if the class that its group's ``_target_`` names takes
    it, or if another value refers to it. Where the reference holds nothing but groups by name
    (callbacks), there may be more of their kind.

    Raises:
        ConfigurationError: names every such key and the nearest known one.
    """
    known, asked = _tree(reference), _tree(config)
    referred = set(_referred(asked))
    unread = list(_unread(asked, known, "", referred))
    if unread:
        names = [path for path, _ in _leaves(known)]
        raise ConfigurationError("\n".join(_sentence(path, kind, names) for path, kind in unread))


def _unread(
    node: Tree, known: Tree, path: str, referred: set[str]
) -> Iterator[tuple[str, str | None]]:
    """Unread keys, each with the name of the class that does not take it, if one is there."""
    target = node.get("_target_")
    takes = parameters(target, f"{path}._target_") if isinstance(target, str) else None
    same = target == known.get("_target_")
    named = bool(known) and all(isinstance(value, Mapping) for value in known.values())
    siblings = _union(known.values()) if named else {}
    for key, value in node.items():
        here = f"{path}.{key}" if path else key
        taken = takes is not None and (key in takes or key in _SPECIAL)
        slip = same and key not in known and bool(difflib.get_close_matches(key, known, 1, 0.75))
        # A class that takes any keyword takes a shipped one with a slip, too.
        of_target = taken or (takes == ALL and not slip)
        if key in known and (same or of_target):
            below = known[key]
            if isinstance(value, Mapping):
                yield from _below(value, below, here, referred)
        elif of_target or _is_referred(here, referred, of_group=takes is None):
            if isinstance(value, Mapping):
                yield from _below(value, None, here, referred)
        elif named and isinstance(value, Mapping):
            yield from _unread(value, {} if "_target_" in value else siblings, here, referred)
        else:
            yield here, None if takes in (None, ALL) else str(target)


def _below(
    value: Tree, known: object, path: str, referred: set[str]
) -> Iterator[tuple[str, str | None]]:
    if isinstance(known, Mapping) and known:
        yield from _unread(value, known, path, referred)
    elif "_target_" in value:  # in the place of a null, or of a value
        yield from _unread(value, {}, path, referred)


ALL = frozenset({"**"})
"""Of a class that takes any keyword."""


def parameters(target: str, key: str) -> frozenset[str]:
    """Keywords that a class or function takes; :data:`ALL` where it takes any.

    Raises:
        ConfigurationError: there is no such thing.
    """
    try:
        signature = inspect.signature(get_object(target))
    except (TypeError, ValueError):  # built in
        return ALL
    except Exception as error:
        reason = str(error).strip().splitlines()
        raise ConfigurationError(
            f"{key}={target}: cannot be imported ({reason[-1] if reason else error!r}); expected "
            "the dotted name of a class, such as package.module.Class"
        ) from error
    kinds = [parameter.kind for parameter in signature.parameters.values()]
    return ALL if inspect.Parameter.VAR_KEYWORD in kinds else frozenset(signature.parameters)


def _referred(node: object) -> Iterator[str]:
    """Keys that interpolations in a tree refer to."""
    if isinstance(node, Mapping):
        for value in node.values():
            yield from _referred(value)
    elif isinstance(node, list):
        for value in node:
            yield from _referred(value)
    elif isinstance(node, str):
        yield from _INTERPOLATION.findall(node)


def _is_referred(path: str, referred: Iterable[str], of_group: bool) -> bool:
    """Whether a key or a part of it is referred to; ``of_group``: or the group it is in."""
    dotted = f"{path}."
    return any(
        f"{name}.".startswith(dotted) or (of_group and dotted.startswith(f"{name}."))
        for name in referred
    )


def _leaves(node: Tree, path: str = "") -> Iterator[tuple[str, object]]:
    for key, value in node.items():
        here = f"{path}.{key}" if path else key
        yield here, value
        if isinstance(value, Mapping):
            yield from _leaves(cast(Tree, value), here)


def _union(nodes: Iterable[object]) -> Tree:
    return {
        key: value for node in nodes if isinstance(node, Mapping) for key, value in node.items()
    }


def _sentence(path: str, target: str | None, names: list[str]) -> str:
    group, _, last = path.rpartition(".")
    if target is not None:
        taken = parameters(target, group)
        close = difflib.get_close_matches(last, taken, 1)
        hint = f"did you mean {group}.{close[0]}?" if close else f"it takes {_listed(taken)}"
        return f"{path}: {target} does not take it; {hint}"
    there = {name.rpartition(".")[2]: name for name in names if name.rpartition(".")[0] == group}
    elsewhere = {name.rpartition(".")[2]: name for name in reversed(names)}
    for known, cutoff in ((there, 0.6), (elsewhere, 0.8)):
        close = difflib.get_close_matches(last, known, 1, cutoff)
        if close:
            return f"{path}: nothing reads this key; did you mean {known[close[0]]}?"
    where = group or "the configuration"
    return f"{path}: nothing reads this key; {where} has {_listed(there)}"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(name.rpartition(".")[2] for name in names)) or "no keys"


def _tree(config: DictConfig) -> Tree:
    return cast(Tree, OmegaConf.to_container(config, resolve=False))
