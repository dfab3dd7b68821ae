"""What the camera contributes: the test once more, with the images permuted among the frames."""

from __future__ import annotations

import lightning
from lightning import LightningModule, Trainer

from uncal.callbacks.uncertainty_calibration import ours
from uncal.inference.split_passes import image_blind_control


class ImageBlindControl(lightning.Callback):
    """Runs the image-blind control before each test; the report makes a row of it."""

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Estimate the test split with and without the frames' own images."""
        module, data = ours(trainer, pl_module, "control")
        module.run.control = image_blind_control(trainer, module, data)
