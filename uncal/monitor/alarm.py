"""An alarm when windows stop looking like the references."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.monitor.evidence import Estimate, EvidenceReader
from uncal.monitor.martingale import ExchangeabilityMartingale
from uncal.monitor.settings import AlarmSettings
from uncal.monitor.statistics import WINDOWED
from uncal.monitor.window import Window


class Alarm:
    """Begins by the martingale's bound on false alarms; ends after some usual windows in a row.

    Args:
        references: (m, K) statistics of the reference windows.
        settings: of the alarm.
        seed: of the martingale's random ties.

    Attributes:
        reason: why there is an alarm; None: there is none.
        calm: usual windows in a row since it began.
        fed: number in the stream of the last frame that the martingale knows.
    """

    def __init__(self, references: NDArray[np.float64], settings: AlarmSettings, seed: int) -> None:
        self.martingale = ExchangeabilityMartingale(references, settings.period, seed)
        self.settings = settings
        self.reason: str | None = None
        self.calm = 0
        self.fed = 0

    def watch(self, window: Window, estimate: Estimate, reader: EvidenceReader) -> None:
        """Feed the martingale with one value per full window, none of whose frames it knows.

        Args:
            window: as it is now.
            estimate: of it.
            reader: of its evidence.
        """
        if len(window) < window.frames or window.entries[0].number <= self.fed:
            return
        self.fed = window.number
        values = window.statistics(estimate, reader)
        wealth = self.martingale.feed(values)
        rate = self.settings.false_alarm_rate
        if self.reason is None and wealth >= 1.0 / rate:
            self.reason = (
                f"windows no longer look like the references, {WINDOWED[self.martingale.oddest]} "
                f"above all (false alarms: {100 * rate:g} % in {self.settings.period} windows)"
            )
            self.calm = 0
            self.martingale.restart()
        elif self.reason is not None:
            # Ville's bound is for how an alarm begins; it ends by a plain rule.
            self.calm = self.calm + 1 if self.martingale.within(values) else 0
            if self.calm >= self.settings.recovery:
                self.reason = None
                self.martingale.restart()
