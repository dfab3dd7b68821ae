"""The x axis of a multirun's figures: one swept number, and lines for whatever else was swept."""

from __future__ import annotations

import math
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uncal.reporting.figures.style import DOUBLE_COLUMN, GREY, light_grid, new_figure, shared_legend
from uncal.reporting.figures.sweep_marks import Series, numbered
from uncal.reporting.figures.sweep_table import Group, Quantity, Sweep, numbers
from uncal.reporting.figures.sweep_words import key_name, sentence

PAPERS_CHOICE = {"mcd.passes": 25.0}
"""Marked by a thin line."""

_PANEL_HEIGHT, _MARGIN = 1.6, 0.7

_MOST_TICKS = 10

_CHARACTER, _BESIDE_PANEL = 0.06, 0.5
"""Inches: width of a tick label's character, and of what stands beside a panel."""

_LOGARITHMIC_FROM = 16.0
"""Largest over smallest value."""


@dataclass(frozen=True)
class Over:
    """What runs along the x axis.

    Attributes:
        sweep: the multirun.
        key: swept, its values numbers.
        series: values of the other swept keys, if any → number → jobs.
    """

    sweep: Sweep
    key: str
    series: dict[tuple[str, ...], dict[float, Group]]

    @classmethod
    def of(cls, sweep: Sweep) -> Over | None:
        """The number with the most values; None if there is none with two.

        Args:
            sweep: the multirun.
        """
        values = {key: [g.values[i] for g in sweep.groups] for i, key in enumerate(sweep.keys)}
        counts = {key: len(set(own)) for key, own in values.items() if numbers(own)}
        if not counts or max(counts.values()) < 2:
            return None
        key = max(counts, key=lambda each: counts[each])  # the first of several
        place = sweep.keys.index(key)
        series: dict[tuple[str, ...], dict[float, Group]] = {}
        for group in sweep.groups:
            rest = group.values[:place] + group.values[place + 1 :]
            series.setdefault(rest, {})[float(group.values[place])] = group
        return cls(sweep, key, series)

    @property
    def alone(self) -> dict[float, Group] | None:
        """Number → jobs, where no other key was swept."""
        return self.series.get(())

    def drawn(self, quantity: Quantity) -> list[Series]:
        """A series for each combination of the other keys.

        Args:
            quantity: of the jobs at one place.
        """
        return [
            numbered(k, ", ".join(rest), {x: quantity(group) for x, group in groups.items()})
            for k, (rest, groups) in enumerate(self.series.items())
        ]

    def figure(self, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
        """Panels over this axis.

        Args:
            rows: of panels.
            columns: of panels.
        """
        height = _MARGIN + _PANEL_HEIGHT * rows
        label = self.sweep.label
        figure, panels = new_figure(rows, columns, height=height, label=label, sharex=True)
        light_grid(panels)
        return figure, panels

    def finish(self, figure: Figure, panels: list[Axes], *, columns: int) -> None:
        """Add what all panels need: the axis, the paper's choice on it, the legend.

        Args:
            figure: of :meth:`figure`.
            panels: drawn.
            columns: of panels.
        """
        places = sorted({x for groups in self.series.values() for x in groups})
        logarithmic = places[0] > 0 and places[-1] / places[0] > _LOGARITHMIC_FROM
        choice = PAPERS_CHOICE.get(self.key)
        for panel in panels:
            if choice is not None and places[0] < choice < places[-1]:
                name = f"{choice:g}, the paper's choice"
                panel.axvline(choice, color=GREY, linewidth=0.8, linestyle="--", label=name)
            if logarithmic:
                panel.set_xscale("log")
            if len(places) <= _MOST_TICKS:
                panel.set_xticks(places, _spaced(places, columns, logarithmic=logarithmic))
                panel.minorticks_off()
        for panel in panels[-columns:]:
            panel.set_xlabel(sentence(key_name(self.key)))
        if panels[0].get_legend_handles_labels()[1]:
            others = ", ".join(key_name(key) for key in self.sweep.keys if key != self.key)
            legend = shared_legend(figure, panels)
            if others:
                legend.set_title(sentence(others))


def _spaced(places: list[float], columns: int, *, logarithmic: bool) -> list[str]:
    """Labels of ticks, those left out that would touch the one before."""
    scale = math.log if logarithmic else float
    inches = (DOUBLE_COLUMN / columns - _BESIDE_PANEL) / (scale(places[-1]) - scale(places[0]))
    labels: list[str] = []
    free = -math.inf
    for place in places:
        label = f"{place:g}"
        half = _CHARACTER * (len(label) + 1) / 2
        middle = inches * scale(place)
        fits = middle - half >= free
        labels.append(label if fits else "")
        free = middle + half if fits else free
    return labels
