"""Digests of what goes into trained weights: settings, files, source code."""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

from torch import nn

PACKAGE = Path(__file__).resolve().parents[1]

TRAINING_CODE: tuple[str, ...] = (
    "geometry",
    "edges",
    "recordings",
    "events",
    "data",
    "models",
    "uncertainty/dropout",
)
"""Folders of this package whose code decides what is learnt."""

INFERENCE_CODE: tuple[str, ...] = (*TRAINING_CODE, "inference")
"""Folders whose code decides what a stochastic pass gives."""

_LIBRARIES = ("torch", "lightning", "torchmetrics", "transformers", "uncal")


def digest_of(value: object) -> str:
    """16 hexadecimal digits of a nesting of dictionaries, lists, strings and numbers.

    >>> digest_of({"a": 1, "b": [0.5]}) == digest_of({"b": [0.5], "a": 1})
    True
    """
    text = json.dumps(value, sort_keys=True, ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def digest_of_files(root: Path) -> str:
    """Digest of a folder's files by relative path, size and time of change, not by contents."""
    listed = []
    for path in root.rglob("*"):
        relative = path.relative_to(root)
        if path.is_file() and not any(part.startswith(".") for part in relative.parts):
            status = path.stat()
            listed.append([relative.as_posix(), status.st_size, status.st_mtime_ns])
    return digest_of(sorted(listed))


def digest_of_file(path: Path) -> str:
    """Digest of a file's bytes: 16 hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


@cache
def own_code() -> Mapping[Path, str]:
    """:func:`meaning` of every file of this package.

    As they are when a process first asks, since it goes on with the code it has.
    """
    return {path: meaning(path) for path in PACKAGE.rglob("*.py")}


def digest_of_code(parts: tuple[str, ...]) -> str:
    """Digest of folders of this package; comments, docstrings and layout do not count."""
    code = own_code()
    files = {path for part in parts for path in code if path.is_relative_to(PACKAGE / part)}
    return digest_of({path.relative_to(PACKAGE).as_posix(): code[path] for path in files})


def digest_of_network(network: nn.Module) -> Mapping[str, str]:
    """Digests of the source of those modules of a network that neither we nor torch bring.

    Returns:
        Python module → digest; "source unknown" where there is no file.
    """
    found: dict[str, str] = {}
    for module in network.modules():
        name = type(module).__module__
        if name.partition(".")[0] not in _LIBRARIES:
            source = _source(name)
            found[name] = digest_of(meaning(source)) if source else "source unknown"
    return found


def digest_of_names(names: Iterable[object]) -> str:
    """Digest of some names, whatever their order.

    >>> digest_of_names(["b", "a"]) == digest_of_names(["a", "b"])
    True
    """
    return digest_of(sorted(map(str, names)))


def meaning(path: Path) -> str:
    """A source file's syntax tree as text, without comments, docstrings and line numbers."""
    text = path.read_text(encoding="utf-8")
    try:
        tree = ast.parse(text)
    except SyntaxError:  # of a newer Python, or being edited: the text itself is what is known
        return text
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = _without_docstring(node.body)
    return ast.dump(tree, annotate_fields=False)


def _without_docstring(body: Sequence[ast.stmt]) -> list[ast.stmt]:
    first = body[0] if body else None
    documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return list(body[1:] if documented else body)


def _source(module: str) -> Path | None:
    path = getattr(sys.modules.get(module), "__file__", None)
    return Path(path) if path and path.endswith(".py") else None
