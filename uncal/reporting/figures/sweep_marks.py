"""How figures of a multirun show series: as lines over a number, or as dots beside a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes

from uncal.geometry import DOF_NAMES
from uncal.reporting.figures.style import (
    BLACK,
    BLUE,
    DOF_COLOURS,
    DOF_LINES,
    DOF_MARKERS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
)
from uncal.reporting.figures.sweep_table import Spread

_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, GREY)
_MARKERS = "os^Dvp*X"
_LINES = ("-", "--", "-.", ":")

_FILLED = 0.7
"""Of the height of a row, by the dots of all six DoF."""

MOST_SERIES = len(_COLOURS)
"""More than these nobody tells apart."""


@dataclass(frozen=True)
class Series:
    """One colour of a figure.

    Attributes:
        label: for the legend; empty for none.
        colour: of line and marker.
        marker: as of matplotlib.
        line: as of matplotlib.
        points: place on the axis of the swept values → what is there; places without are absent.
    """

    label: str
    colour: str
    marker: str
    line: str
    points: dict[float, Spread]


def numbered(index: int, label: str, points: dict[float, Spread | None]) -> Series:
    """A series with the next look of the palette.

    Args:
        index: its number.
        label: for the legend.
        points: place → what is there.
    """
    k = index % MOST_SERIES
    found = {place: spread for place, spread in points.items() if spread}
    return Series(label, _COLOURS[k], _MARKERS[k], _LINES[k % len(_LINES)], found)


def of_dof(dof: str, points: dict[float, Spread | None]) -> Series:
    """A series with the look that a DoF has everywhere.

    Args:
        dof: X, Y, Z, Roll, Pitch or Yaw.
        points: place → what is there.
    """
    found = {place: spread for place, spread in points.items() if spread}
    return Series(dof, DOF_COLOURS[dof], DOF_MARKERS[dof], DOF_LINES[dof], found)


def lines(panel: Axes, series: Sequence[Series], *, bands: bool = True) -> None:
    """Means as lines, lowest to highest replicate as bands.

    Args:
        panel: where.
        series: over the same axis.
        bands: whether to draw those; with many series they would hide each other.
    """
    for each in series:
        places = sorted(each.points)
        spreads = [each.points[place] for place in places]
        if bands and any(spread.count > 1 for spread in spreads):
            low, high = [s.low for s in spreads], [s.high for s in spreads]
            panel.fill_between(places, low, high, color=each.colour, alpha=0.2, linewidth=0)
        panel.plot(
            places,
            [spread.mean for spread in spreads],
            color=each.colour,
            marker=each.marker,
            linestyle=each.line,
            label=each.label,
        )


def dots(panel: Axes, series: Sequence[Series]) -> None:
    """Means as dots, lowest to highest replicate as bars; the series of a row below each other.

    Args:
        panel: where; rows are at 0, 1, … from the top.
        series: over the same rows.
    """
    step = _FILLED / max(len(series), len(DOF_NAMES))
    for k, each in enumerate(series):
        shift = step * (k - (len(series) - 1) / 2)
        rows = [place + shift for place in each.points]
        for row, spread in zip(rows, each.points.values(), strict=True):
            if spread.count > 1:
                panel.plot([spread.low, spread.high], [row, row], color=each.colour, linewidth=1)
        panel.plot(
            [spread.mean for spread in each.points.values()],
            rows,
            color=each.colour,
            marker=each.marker,
            linestyle="none",
            label=each.label,
        )


def name_rows(panels: Sequence[Axes], names: Sequence[str]) -> None:
    """Swept values at the rows of dots, the first on top, with faint lines between the rows.

    Args:
        panels: beside each other.
        names: of the rows.
    """
    for panel in panels:
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.set_yticks(range(len(names)), [])
        panel.tick_params(axis="y", length=0)
        panel.grid(visible=True, axis="x")
        for edge in range(1, len(names)):
            panel.axhline(edge - 0.5, color="#BFBFBF", linewidth=0.5)
    panels[0].set_yticks(range(len(names)), names)
