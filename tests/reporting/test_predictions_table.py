from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import pytest
import torch
from torch import Tensor

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.evaluation import Evaluation
from uncal.reporting.frames import PREDICTIONS, bound_columns, read_csv, write_csv
from uncal.reporting.measure import predictions_table
from uncal.uncertainty import AbsoluteCalibrator, ConformalCalibrator, IntervalCalibrator

FRAMES = ["rig/drive/0000000004", "rig/drive/0000000002"]


def _fitted() -> ConformalCalibrator:
    """Nine scores 0.5, 1.0, … 4.5 per DoF: q is 4.5 at 90 %, 2.5 at 50 %, infinite at 95 %."""
    scores = torch.arange(1.0, 10.0, dtype=torch.float64)[:, None].expand(9, 6) / 2
    one = torch.ones(9, 6, dtype=torch.float64)
    return ConformalCalibrator(DOF_NAMES).fit(0 * one, one, scores)


def _tested(calibrator: IntervalCalibrator | None = None) -> Evaluation:
    def six(translation: float, rotation: float) -> list[float]:
        return [translation] * 3 + [math.radians(rotation)] * 3

    def column(*rows: list[float]) -> Tensor:
        return torch.tensor(rows, dtype=torch.float64)

    return Evaluation(
        mean=column(six(0.03, 0.3), six(-0.05, -0.5)),
        std=column(six(0.01, 0.1), six(0.02, 0.2)),
        target=column(six(0.04, 0.4), six(0.05, 0.5)),
        calibrator=calibrator or _fitted(),
    )


def _rows() -> pd.DataFrame:
    return predictions_table(_tested(), [0.9, 0.5], FRAMES)


def _bounds(row: pd.Series[float], level: float) -> tuple[float, float]:
    lower, upper = bound_columns(level)
    return row[lower], row[upper]


def test_hand_computed_rows_in_centimetres_and_degrees() -> None:
    rows = _rows()
    assert list(zip(rows["frame"], rows["dof"], strict=True)) == [
        (f, d) for f in FRAMES for d in DOF_NAMES
    ]
    x, yaw = rows.iloc[0], rows.iloc[11]
    assert (x.unit, yaw.unit) == ("cm", "°")
    assert (x.truth, x.estimate, x.sigma) == pytest.approx((4.0, 3.0, 1.0))
    assert (yaw.truth, yaw.estimate, yaw.sigma) == pytest.approx((0.5, -0.5, 0.2))
    assert _bounds(x, 90.0) == pytest.approx((3.0 - 4.5, 3.0 + 4.5))
    assert _bounds(x, 50.0) == pytest.approx((3.0 - 2.5, 3.0 + 2.5))
    assert _bounds(yaw, 90.0) == pytest.approx((-0.5 - 0.9, -0.5 + 0.9))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_is_written_reads_back_exactly(tmp_path: Path) -> None:
    rows = predictions_table(_tested(), [0.9, 0.95, 0.125], FRAMES)
    path = write_csv(tmp_path / "predictions.csv", rows)
    header = path.read_text(encoding="utf-8").splitlines()[0]
    assert header == (
        "frame,dof,unit,truth,estimate,sigma,"
        "lower_90,upper_90,lower_95,upper_95,lower_12.5,upper_12.5"
    )
    pd.testing.assert_frame_equal(read_csv(path, PREDICTIONS), rows, check_exact=True)
    assert _bounds(rows.iloc[3], 95.0) == (-math.inf, math.inf)


def test_a_calibrator_without_sigma_gives_equal_widths() -> None:
    one = torch.ones(9, 6, dtype=torch.float64)
    fitted = AbsoluteCalibrator(DOF_NAMES).fit(0 * one, one, one)
    rows = predictions_table(_tested(fitted), [0.5], FRAMES)
    # |error| is 1 m on every frame of the fit, whatever σ.
    z = rows[rows["dof"] == "Z"]
    assert (z["upper_50"] - z["lower_50"]).tolist() == [200, 200]


def test_one_name_per_frame_is_needed() -> None:
    with pytest.raises(ValueError, match="1 frame names for 2 samples"):
        predictions_table(_tested(), [0.9], FRAMES[:1])


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: "", "No columns"),
        (lambda text: text.splitlines()[0] + "\n", "it has no rows"),
        (lambda text: text[:-3], "last line is cut off"),
        (lambda text: text[: len(text) // 2], "has no |expected number|cut off"),
        (
            lambda text: "".join(text.splitlines(keepends=True)[:-1]),
            f"{FRAMES[1]} has rows for X, Y, Z, Roll, Pitch, not for",
        ),
        (lambda text: text.replace("upper_90", "upper_91"), "no column upper_90"),
        (lambda text: text.replace("sigma", "std"), "no column sigma"),
        (lambda text: text.replace("lower_90", "lower_x"), "'x'"),
        (
            lambda text: text.replace("Pitch", "Pinch"),
            f"{FRAMES[0]} has rows for X, Y, Z, Roll, Pinch",
        ),
        (lambda text: text.replace("cm,4.0,", "cm,nan,"), "line 2: truth is 'nan'"),
        (lambda text: text.replace("cm,4.0,", "cm,four,"), "line 2: truth is 'four'"),
        (lambda text: text.replace("cm,4.0,", "cm,,"), "line 2 has no truth"),
        (lambda text: text.replace("rig", "\udcff"), "utf-8"),
    ],
)
def test_a_damaged_file_is_named_with_a_remedy(tmp_path: Path, damage: object, reason: str) -> None:
    assert callable(damage)
    path = write_csv(tmp_path / "predictions.csv", _rows())
    text = path.read_text(encoding="utf-8")
    assert "cm,4.0," in text
    path.write_bytes(damage(text).encode("utf-8", "surrogateescape"))
    with pytest.raises(UncalError, match=reason) as caught:
        read_csv(path, PREDICTIONS)
    assert str(path) in str(caught.value)
    assert "python -m uncal.evaluate" in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UncalError, match=r"nowhere\.csv"):
        read_csv(tmp_path / "nowhere.csv", PREDICTIONS)
