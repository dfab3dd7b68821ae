"""What there is to start: ``python -m uncal``."""

from __future__ import annotations

import sys

ENTRY_POINTS: dict[str, str] = {
    "train": "train, calibrate the uncertainty, test; without arguments on a simulated demo",
    "evaluate": "test trained weights (weights=unical) with other recordings or settings",
    "monitor": "watch a stream: per frame an estimate, an interval, a verdict",
    "check": "look for the usual mistakes in recordings",
    "convert": "a plain folder from a ROS bag or MCAP file",
    "calibrate": "fit the intervals of trained weights to recordings of your own rig",
    "export": "trained weights as one ONNX graph",
    "simulate": "write recordings of simulated streets",
    "report": "runs beside the paper's tables, on one HTML page",
    "benchmark": "measure what stochastic passes cost",
    "ship": "a finished run as weights that can be passed on",
    "simulation.formats.bag": "a simulated drive as a ROS bag",
    "monitor.experiment": "measure the monitor on simulated faults",
}


def page() -> str:
    """The list, for a terminal."""
    width = max(map(len, ENTRY_POINTS))
    lines = [f"  python -m uncal.{name:<{width}}  {what}" for name, what in ENTRY_POINTS.items()]
    return "\n".join(["Error bars on online LiDAR-camera calibration. Start one of", "", *lines, "",
                      "each with --help."])  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(f"{page()}\n")
    raise SystemExit(0 if set(sys.argv[1:]) <= {"-h", "--help"} else 2)
