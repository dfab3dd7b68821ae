"""Pictures for TensorBoard."""

from __future__ import annotations

from pathlib import Path

from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[import-untyped]
from torch.utils.tensorboard import SummaryWriter


def add_png(writer: SummaryWriter, tag: str, path: Path, step: int | None = None) -> None:
    """Log a PNG as it is; ``add_image`` would encode its pixels again, in up to half a second.

    A file that is missing or no picture is left out.
    """
    try:
        with Image.open(path) as image:
            (width, height), channels = image.size, len(image.getbands())
    except OSError:
        return
    picture = Summary.Image(
        height=height,
        width=width,
        colorspace=channels,
        encoded_image_string=path.read_bytes(),
    )
    summary = Summary(value=[Summary.Value(tag=tag, image=picture)])
    writer._get_file_writer().add_summary(summary, step)  # type: ignore[no-untyped-call]
