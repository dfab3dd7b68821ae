"""What a monitor knows, as plain values and tensors that a file can hold."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch

from uncal.monitor.evidence import Evidence
from uncal.monitor.extrinsic import Change, ExtrinsicInUse
from uncal.monitor.monitor import Monitor
from uncal.monitor.pairing import Glimpse
from uncal.monitor.window import Entry

State = dict[str, Any]


def state_of(monitor: Monitor) -> State:
    """All that the next verdict depends on, but for weights, references and settings.

    Args:
        monitor: at any moment between two frames.
    """
    in_use, alarm = monitor.in_use, monitor.alarm
    martingale = None if alarm is None else alarm.martingale
    return {
        "rig": monitor.rig,
        "drive": monitor.drive,
        "number": monitor.window.number,
        "entries": [
            {
                "number": entry.number,
                "trusted": entry.trusted,
                "equations": entry.evidence.equations.cpu(),
                "statistics": torch.from_numpy(entry.evidence.statistics),
            }
            for entry in monitor.window.entries
        ],
        "last": list(monitor.check.last),
        "alarm": alarm and alarm.reason,
        "calm": alarm.calm if alarm else 0,
        "fed": alarm.fed if alarm else 0,
        "quantiles": [
            {name: torch.tensor(v) for name, v in quantiles.state().items()}
            for quantiles in (monitor.quantiles, monitor.drift)
        ],
        "past": [[part.cpu() for part in glimpse] for glimpse in monitor.pairing.past],
        "better": list(monitor.pairing.better),
        "martingale": None
        if martingale is None
        else {
            "tests": martingale.tests,
            "fed": torch.tensor(np.array(martingale.fed)),
            "shares": torch.from_numpy(martingale.shares.copy()),
        },
        "in_use": None
        if in_use is None
        else {
            "nominal": torch.from_numpy(in_use.nominal),
            "current": torch.from_numpy(in_use.current),
            "agreed": in_use.agreed,
            "history": [change.as_json() for change in in_use.history],
        },
    }


def restore(monitor: Monitor, state: State) -> None:
    """Make a fresh monitor what another one was.

    Args:
        monitor: with the same weights, references and settings.
        state: of :func:`state_of`.
    """
    monitor.rig, monitor.drive = state["rig"], state["drive"]
    monitor.window.number = state["number"]
    monitor.window.entries.extend(
        Entry(
            entry["number"],
            Evidence(entry["equations"].to(monitor.reader.device), entry["statistics"].numpy()),
            entry["trusted"],
        )
        for entry in state["entries"]
    )
    camera, lidar = state["last"]
    monitor.check.last = (camera, lidar)
    for quantiles, known in zip(
        (monitor.quantiles, monitor.drift), state["quantiles"], strict=True
    ):
        if known:
            quantiles.load({name: v.numpy() for name, v in known.items()})
    device = monitor.reader.device
    monitor.pairing.past.extend(
        Glimpse(*(part.to(device) for part in parts)) for parts in state["past"]
    )
    monitor.pairing.better.extend(state["better"])
    alarm = monitor.alarm
    if alarm is not None and state["martingale"] is not None:
        alarm.reason, alarm.calm, alarm.fed = state["alarm"], state["calm"], state["fed"]
        known = state["martingale"]
        alarm.martingale.go_on(known["tests"], known["fed"].numpy(), known["shares"].numpy())
    if state["in_use"] is not None:
        known = state["in_use"]
        in_use = ExtrinsicInUse(known["nominal"].numpy(), monitor.settings.update)
        in_use.current = known["current"].numpy()
        in_use.agreed = known["agreed"]
        in_use.history = [
            Change(
                cast(str, line["frame"]),
                cast(str, line["reason"]),
                np.array(line["before"]),
                np.array(line["after"]),
            )
            for line in known["history"]
        ]
        monitor.in_use = in_use
