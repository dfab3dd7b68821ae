"""Online monitoring of an extrinsic: per frame an estimate, an interval and a verdict.

>>> from uncal.monitor import Monitor  # doctest: +SKIP
>>> monitor = Monitor("unical")  # doctest: +SKIP
>>> print(monitor.update(frame).reason)  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uncal.monitor.monitor import Monitor
    from uncal.monitor.settings import MonitorSettings
    from uncal.monitor.verdict import Verdict

__all__ = ["Monitor", "MonitorSettings", "Verdict"]


def __getattr__(name: str) -> object:
    # Late, since --help of python -m uncal.monitor must not import torch.
    if name == "Monitor":
        from uncal.monitor.monitor import Monitor

        return Monitor
    if name == "MonitorSettings":
        from uncal.monitor.settings import MonitorSettings

        return MonitorSettings
    if name == "Verdict":
        from uncal.monitor.verdict import Verdict

        return Verdict
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
