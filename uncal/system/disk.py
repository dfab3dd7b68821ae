"""A disk that takes no more, said in a sentence."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

_FULL = (errno.ENOSPC, errno.EDQUOT)
_SAID = (
    "No space left on device",
    "PytorchStreamWriter failed",
    "unexpected pos",
    "Disk quota exceeded",
)
"""What libraries that do not pass the number on say of a full disk."""

_NUMBERED = re.compile(r'\(os error (\d+)\)(?: at path "([^"]+)")?')
"""How libraries in Rust, such as safetensors, pass it on."""

_REFUSED = {
    errno.EROFS: "the disk can only be read",
    errno.EACCES: "permission denied",
    errno.EPERM: "permission denied",
    errno.ENOTDIR: "a file, where a folder must be",
    errno.EEXIST: "a file, where a folder must be",
    errno.EISDIR: "a folder, where a file must be",
}


def disk_trouble(error: BaseException) -> str | None:
    """What a user can do about an error of writing; None for any other error.

    >>> disk_trouble(OSError(errno.ENOSPC, "No space left on device", "out/results.csv"))
    'out/results.csv: no space left on the disk. Free some, or write elsewhere (hydra.run.dir=…, \
store=…, dataset.root=…); finished files are as they were, and the same command goes on.'
    >>> disk_trouble(ValueError("x"))
    """
    for cause in map(_as_os_error, chain_of(error)):
        full = isinstance(cause, OSError) and cause.errno in _FULL
        if full or any(words in str(cause) for words in _SAID):
            where = f"{cause.filename}: " if isinstance(cause, OSError) and cause.filename else ""
            return (
                f"{where}no space left on the disk. Free some, or write elsewhere "
                "(hydra.run.dir=…, store=…, dataset.root=…); finished files are as they were, and "
                "the same command goes on."
            )
        if isinstance(cause, OSError) and cause.filename and cause.errno in _REFUSED:
            return (
                f"{cause.filename}: {_REFUSED[cause.errno]}. Name another place (hydra.run.dir=…, "
                "store=…, dataset.root=…, root=…, out=…), or change this one."
            )
    return None


def _as_os_error(error: BaseException) -> BaseException:
    numbered = None if isinstance(error, OSError) else _NUMBERED.search(str(error))
    if numbered is None:
        return error
    return OSError(int(numbered[1]), os.strerror(int(numbered[1])), numbered[2])


def check_writable(path: Path) -> None:
    """Find out before the work whether a file can be written; makes its folder, changes no file.

    Raises:
        OSError: it cannot be.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:  # which names the temporary file
        raise OSError(error.errno, error.strerror, str(path)) from error


def chain_of(error: BaseException | None) -> Iterator[BaseException]:
    """An error, what caused it, what caused that."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__
