"""What a run learns about itself on its way from weights to report."""

from __future__ import annotations

from dataclasses import dataclass, field

from uncal.models.split_prediction import ControlPrediction, SplitPrediction


@dataclass
class RunState:
    """Filled by entry point, test loop and callbacks; read by whoever writes results.

    Attributes:
        notes: sentences for the report on where weights and intervals come from.
        tested: predictions of the test split.
        control: the image-blind control; None where it is off or found fewer than two frames.
        mean_ratio: mean over the DoF of MAE after / before; None until it has been measured.
    """

    notes: list[str] = field(default_factory=list)
    tested: SplitPrediction | None = None
    control: ControlPrediction | None = None
    mean_ratio: float | None = None
