"""Tables of the experiment, out of the rows of :func:`uncal.monitor.experiment.observe.observe`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2  # type: ignore[import-untyped]

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.monitor.experiment.cases import BLIND, FAULT, STEP, STILL

Vector = NDArray[np.float64]

MONITOR, SINGLE, MEAN = "monitor", "single", "mean"

WATCHERS: dict[str, str] = {
    MONITOR: "monitor",
    SINGLE: "single frame, fixed limit",
    MEAN: "running mean, fixed limit",
}


@dataclass(frozen=True)
class Experiment:
    """What the rows were measured with.

    Attributes:
        rows: one per watcher, case, drive and frame.
        onset: first frame with the motion or the fault.
        window: frames of the monitor's window.
        interval_s: between frames.
        limit: (6,) of the plainer watchers, metres and radians.
        bounds: (6,) the range of decalibrations, metres and radians.
    """

    rows: pd.DataFrame
    onset: int
    window: int
    interval_s: float
    limit: Vector
    bounds: Vector

    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by name."""
        return {
            "detection": self.detection(),
            "alarms": self.alarms(),
            "error": self.error(),
            "coverage": self.coverage(),
            "updates": self.updates(),
            "faults": self.faults(),
            "blind": self.blind(),
        }

    def detection(self) -> pd.DataFrame:
        """Share of drives in which the motion was noticed, and the median delay in frames."""
        found = []
        for case, dof, size, rows in self._cases(moving=True):
            entry: dict[str, object] = {"case": case, "dof": dof, "size": size}
            entry["drives"] = rows["drive"].nunique()
            for watcher in WATCHERS:
                delays = self._delays(rows, self.flagged(rows, watcher))
                entry[f"{watcher}_detected"] = float(np.isfinite(delays).mean() * 100)
                entry[f"{watcher}_delay"] = _median(delays[np.isfinite(delays)])
            found.append(entry)
        return pd.DataFrame(found)

    def alarms(self) -> pd.DataFrame:
        """False alarms where nothing moves, and how often the monitor is needlessly untrusting."""
        rows = self._begun(self._of(MONITOR, STILL))
        flags = {name: self.flagged(rows, watcher) for watcher, name in WATCHERS.items()}
        flags["monitor: untrusted"] = rows["untrusted"].to_numpy(bool)
        hours = len(rows) * self.interval_s / 3600
        found = []
        for name, flag in flags.items():
            begun = flag & ~_previous(flag, rows["drive"].to_numpy())
            n = int(begun.sum())
            found.append(
                {
                    "watcher": name,
                    "frames": len(rows),
                    "hours": hours,
                    "alarmed_frames": float(100 * flag.mean()) if len(flag) else np.nan,
                    "alarms": n,
                    "per_hour": n / hours if hours else np.nan,
                    "per_hour_upper_95": float(chi2.ppf(0.95, 2 * n + 2) / 2 / hours)
                    if hours
                    else np.nan,
                }
            )
        return pd.DataFrame(found)

    def error(self) -> pd.DataFrame:
        """Mean error over the last window of the drives: of the DoF that moved, and as a whole."""
        found = []
        for case, dof, size, rows in self._cases(moving=False):
            last = rows[rows["number"] > rows["number"].max() - self.window]
            nominal = vectors(last, "nominal")
            left = {
                "nothing": nominal,
                MONITOR: vectors(last, "after"),
                MEAN: nominal - vectors(last, "mean"),
                SINGLE: nominal - vectors(last, "single"),
            }
            entry: dict[str, object] = {"case": case, "dof": dof, "size": size}
            for name, D in left.items():
                if dof:
                    j = DOF_NAMES.index(dof)
                    entry[f"{name}_dof"] = float(np.nanmean(np.abs(D[:, j])) * DOF_SCALE[j])
                entry[f"{name}_cm"] = float(100 * np.nanmean(np.linalg.norm(D[:, :3], axis=1)))
                entry[f"{name}_deg"] = float(
                    np.rad2deg(np.nanmean(np.linalg.norm(D[:, 3:], axis=1)))
                )
            found.append(entry)
        return pd.DataFrame(found)

    def coverage(self) -> pd.DataFrame:
        """How often the monitor's intervals hold the decalibration of the extrinsic in use."""
        found = []
        for kind in dict.fromkeys(self.rows["kind"]):
            rows = self._of(MONITOR, kind)
            rows = rows[rows["full"]]
            number = rows["number"].to_numpy()
            begun, settled = number >= self.onset, number >= self.onset + self.window
            phases = (
                {"all": begun | ~begun}
                if kind == STILL
                else {
                    "before": ~begun,
                    "window holds both": begun & ~settled,
                    "after": settled,
                }
            )
            for phase, chosen in phases.items():
                part = rows[chosen]
                held = 100 * vectors(part, "inside").mean(0) if len(part) else np.full(6, np.nan)
                found.append(
                    {"kind": kind, "phase": phase, "frames": len(part)}
                    | dict(zip(DOF_NAMES, held.tolist(), strict=True))
                    | {"joint": float(100 * part["joint"].mean())}
                )
        return pd.DataFrame(found)

    def updates(self) -> pd.DataFrame:
        """Updates of the extrinsic in use, and how many of them made it worse."""
        found = []
        for kind in dict.fromkeys(self.rows["kind"]):
            rows = self._of(MONITOR, kind)
            moved = rows[rows["updated"]]
            size = [self.size(vectors(moved, name)) for name in ("before", "after")]
            harmful = int((size[1] > size[0]).sum())
            found.append(
                {
                    "kind": kind,
                    "frames": len(rows),
                    "updates": len(moved),
                    "harmful": harmful,
                    "harmful_share": 100 * harmful / len(moved) if len(moved) else np.nan,
                    "largest_harm": float((size[1] - size[0]).max()) if harmful else 0.0,
                }
            )
        return pd.DataFrame(found)

    def faults(self) -> pd.DataFrame:
        """How much of each fault is flagged ``untrusted``, how soon, and what it did meanwhile."""
        found = []
        every = self._of(MONITOR, FAULT)
        for case in dict.fromkeys(every["case"]):
            rows = every[every["case"] == case]
            delays = self._delays(rows, rows["untrusted"].to_numpy(bool))
            during = rows[rows["number"] >= self.onset]
            before = self._begun(rows[rows["number"] < self.onset])
            moved = during[during["updated"]]
            worse = self.size(vectors(moved, "after")) > self.size(vectors(moved, "before"))
            found.append(
                {
                    "fault": case,
                    "drives": rows["drive"].nunique(),
                    "untrusted_before": float(100 * before["untrusted"].mean()),
                    "untrusted": float(100 * during["untrusted"].mean()),
                    "flagged": float(100 * np.isfinite(delays).mean()),
                    "delay": _median(delays[np.isfinite(delays)]),
                    "says_moved": float(100 * during["alarm"].mean()),
                    "updates": len(moved),
                    "harmful": int(worse.sum()),
                }
            )
        return pd.DataFrame(found)

    def blind(self) -> pd.DataFrame:
        """What is left with another drive's images: nothing may follow the motion.

        Response: (estimate with the motion - estimate without) / true decalibration, of the
        running mean over the last window of the same street; 1 follows the motion, 0 does not.
        """
        found = []
        for watcher in (MONITOR, BLIND):
            still = self._of(watcher, STILL)
            every = self._of(watcher, STEP)
            blind = self._of(BLIND, STEP)
            every = every[every["case"].isin(blind["case"]) & every["drive"].isin(blind["drive"])]
            for dof in dict.fromkeys(every["dof"]):
                rows = every[every["dof"] == dof]
                begun = rows["number"] >= self.onset
                both = rows.merge(still, on=["drive", "number"], suffixes=("", "_still"))
                both = both[both["number"] > both["number"].max() - self.window]
                change = (both[f"mean {dof}"] - both[f"mean {dof}_still"]) / both[f"nominal {dof}"]
                per_drive = change.groupby(both["drive"]).mean()
                found.append(
                    {
                        "watcher": watcher,
                        "dof": dof,
                        "size": rows["size"].iloc[0],
                        "drives": len(per_drive),
                        "alarmed_before": float(100 * rows[~begun]["alarm"].mean()),
                        "alarmed_after": float(100 * rows[begun]["alarm"].mean()),
                        "untrusted": float(100 * rows["untrusted"].mean()),
                        "response": _median(per_drive.to_numpy()),
                    }
                )
        return pd.DataFrame(found)

    def flagged(self, rows: pd.DataFrame, watcher: str) -> NDArray[np.bool_]:
        """Frames at which a watcher says that the extrinsic is wrong.

        Args:
            rows: of the monitor.
            watcher: one of :data:`WATCHERS`.
        """
        if watcher == MONITOR:
            return rows["alarm"].to_numpy(bool)
        return np.asarray((np.abs(vectors(rows, watcher)) > self.limit).any(1))

    def size(self, D: Vector) -> Vector:
        """(n,) root mean square over the DoF, in units of the range."""
        return np.asarray(np.sqrt(((D / self.bounds) ** 2).mean(1)))

    def _of(self, watcher: str, kind: str) -> pd.DataFrame:
        return self.rows[(self.rows["watcher"] == watcher) & (self.rows["kind"] == kind)]

    def _begun(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Without the frames that fill the first window of a drive."""
        return rows[rows["number"] >= self.window - 1]

    def _cases(self, moving: bool) -> Iterator[tuple[str, str, float, pd.DataFrame]]:
        """Kind, DoF, size and rows of the monitor; ``moving``: none at rest."""
        own = self.rows[(self.rows["watcher"] == MONITOR) & (self.rows["kind"] != FAULT)]
        for case in dict.fromkeys(own["case"]):
            rows = own[own["case"] == case]
            first = rows.iloc[0]
            if not moving or first["kind"] != STILL:
                yield str(first["kind"]), str(first["dof"]), float(first["size"]), rows

    def _delays(self, rows: pd.DataFrame, flag: NDArray[np.bool_]) -> Vector:
        """(drives,) frames from the onset to the first flag; infinite without one."""
        hit = rows[flag & (rows["number"] >= self.onset).to_numpy()]
        first = hit.groupby("drive")["number"].min() - self.onset
        return first.reindex(rows["drive"].unique()).fillna(np.inf).to_numpy(float)


def vectors(rows: pd.DataFrame, name: str) -> Vector:
    """(n, 6) of the columns ``<name> <DoF>``."""
    return rows[[f"{name} {dof}" for dof in DOF_NAMES]].to_numpy(float)


def unit_of(dof: str) -> str:
    """Unit of a size: cm or °; nothing without a DoF."""
    return DOF_UNITS[DOF_NAMES.index(dof)] if dof else ""


def _previous(flag: NDArray[np.bool_], drive: NDArray[np.object_]) -> NDArray[np.bool_]:
    """Whether the frame before, of the same drive, was flagged."""
    before = np.zeros_like(flag)
    before[1:] = flag[:-1] & (drive[1:] == drive[:-1])
    return before


def _median(values: Vector) -> float:
    return float(np.median(values)) if len(values) else float("nan")
