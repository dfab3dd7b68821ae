"""Checkpoints written whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

from uncal.reporting.layout import replaced_whole


def save_whole(content: object, path: Path) -> None:
    """``torch.save``, after which the file is new as a whole, or as it was.

    Args:
        content: what torch can save.
        path: the file; its folder is made if it is not there.
    """
    # Of a full disk torch's own writer says nothing that could be understood.
    buffer = io.BytesIO()
    torch.save(content, buffer)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_whole(path) as partial:
        partial.write_bytes(buffer.getbuffer())


class WholeCheckpoints(TorchCheckpointIO):
    """Writes Lightning's checkpoints beside their place and moves them there in one step.

    Lightning's own move comes from the system's folder for temporary files. From there to another
    disk it is a copy, which a killed process or a full disk cuts short over the last good file.
    """

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | Path,
        storage_options: object = None,
    ) -> None:
        """Write.

        Args:
            checkpoint: what Lightning has put together.
            path: where to.
            storage_options: of remote file systems; not used.
        """
        save_whole(checkpoint, Path(path))
