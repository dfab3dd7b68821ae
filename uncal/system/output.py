"""Output that outlives its reader: ``python -m uncal.train | head -1`` ends as it would without."""

from __future__ import annotations

import os
import sys
from typing import TextIO, cast


class Outliving:
    """A stream that drops what is written after its reader has gone.

    Results are in files; a run must not end, nor its log fill with tracebacks, because nobody
    looks at its terminal any more.

    Args:
        stream: of the process, with a file descriptor.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """As of any stream.

        Args:
            text: to write.
        """
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._drop()
            return len(text)

    def flush(self) -> None:
        """As of any stream."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._drop()

    def __getattr__(self, name: str) -> object:
        """Everything else is the stream's own."""
        return getattr(self._stream, name)

    def _drop(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


def outlive_readers() -> None:
    """Let this process's output outlive its readers; a second call does nothing."""
    # What tests or a notebook have put in their place stays.
    if sys.stdout is sys.__stdout__ and sys.stdout is not None:
        sys.stdout = cast(TextIO, Outliving(sys.stdout))
    if sys.stderr is sys.__stderr__ and sys.stderr is not None:
        sys.stderr = cast(TextIO, Outliving(sys.stderr))
