"""What a run learns about itself on its way from weights to report."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uncal.models.split_prediction import ControlPrediction, SplitPrediction
    from uncal.reporting.measure import Results


@dataclass
class RunState:
    """Filled by entry point, test loop and callbacks; read by whoever writes results.

    Attributes:
        notes: sentences for the report on where weights and intervals come from.
        tested: predictions of the test split.
        control: the image-blind control; None where it is off or found fewer than two frames.
        results: the measured tables.
    """

    notes: list[str] = field(default_factory=list)
    tested: SplitPrediction | None = None
    control: ControlPrediction | None = None
    results: Results | None = None
