from pathlib import Path

import cv2
import numpy as np
from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
    EventAccumulator,
)

from uncal.multirun.figures import show_in_tensorboard


def test_pictures_are_shown_by_name_and_an_earlier_showing_goes(tmp_path: Path) -> None:
    picture = tmp_path / "interval_score.png"
    cv2.imwrite(str(picture), np.full((4, 6, 3), 200, np.uint8))
    for shown in ([picture], [picture, tmp_path / "missing.png"]):
        show_in_tensorboard(shown, tmp_path)
    assert len(list(tmp_path.glob("events.out.tfevents.*"))) == 1
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert events.Tags()["images"] == ["multirun/interval_score"]
    (image,) = events.Images("multirun/interval_score")
    assert (image.width, image.height) == (6, 4)
