"""The figures of a run, in its folder and in TensorBoard."""

from __future__ import annotations

import logging
from pathlib import Path

import lightning
from lightning import LightningModule, Trainer

from uncal.callbacks.overlays import show_picture
from uncal.models.module import CalibrationModule
from uncal.reporting.figures.run_figures import figure_makers
from uncal.reporting.figures.style import save
from uncal.reporting.run import Run
from uncal.reporting.run_record import read_record

log = logging.getLogger(__name__)


class Figures(lightning.Callback):
    """Draws all figures of a run after its test, from the files of ``report``.

    Args:
        folder: the run's folder; the figures go to ``figures`` in it.
        label: what the data are, such as "simulated"; stands in every figure.
    """

    def __init__(self, folder: str, label: str) -> None:
        self.folder = Path(folder)
        self.label = label

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Draw, write, log; a figure that fails is named, and the others and the run go on."""
        if stage != "test" or not trainer.is_global_zero:
            return
        record = (read_record(self.folder) or {}) | {"label": self.label}
        if isinstance(pl_module, CalibrationModule):  # its record is still to be written
            record["settings"] = pl_module.recipe
        run = Run(self.folder, record)
        for name, draw in figure_makers(run).items():
            try:
                if (figure := draw()) is not None:
                    png, _ = save(figure, self.folder / "figures")
                    show_picture(trainer, png, f"figure/{name}")
            except Exception as error:
                # Whatever it is: hours of training must not end here.
                log.error("figure %s was not drawn: %s: %s", name, type(error).__name__, error)
