"""What the camera contributes: the test once more, with the images permuted among the frames."""

from __future__ import annotations

import lightning
from lightning import LightningModule, Trainer

from uncal.data.datamodule import CalibrationDataModule
from uncal.errors import ConfigurationError
from uncal.models.control import image_blind_control
from uncal.models.module import CalibrationModule


class ImageBlindControl(lightning.Callback):
    """Runs the image-blind control before each test; the report makes a row of it."""

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Estimate the test split with and without the frames' own images.

        Raises:
            ConfigurationError: the module or the data are not ours.
        """
        data = getattr(trainer, "datamodule", None)
        if not isinstance(pl_module, CalibrationModule) or not isinstance(
            data, CalibrationDataModule
        ):
            raise ConfigurationError(
                "ImageBlindControl needs a CalibrationModule and a CalibrationDataModule, got "
                f"{type(pl_module).__name__} and {type(data).__name__}: drop callbacks.control"
            )
        pl_module.run.control = image_blind_control(trainer, pl_module, data)
