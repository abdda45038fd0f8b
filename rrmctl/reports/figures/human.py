"""Learning from people: each seed's curve smoothed, then the interquartile mean and quartiles over seeds.

People answer for few seeds, whose curves jump; the window is told below the figure, and a thin line is not smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rrmctl.labels import HUMAN
from rrmctl.reports.figure_layout import Axes, Figure, Slot, from_frames, sheet
from rrmctl.reports.plot_elements import curves_slot, iqm_notes, line, panel_name, scaled
from rrmctl.reports.series import Section, Series
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import Floats, IqmKind, iqm

#: Evaluations.
WINDOW = 5


def suits(section: Section) -> bool:
    """People taught in some of its runs."""
    return any(panel.teacher == HUMAN for panel in section.panels())


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """Smoothed learning curves, a panel for each task that people taught (of every task, where they taught none)."""
    panels, looks = section.panels(), section.looks()
    shown = [panel for panel in panels if panel.teacher == HUMAN] or panels
    slots = [_slot(panel_name(panel, panels), panel.present(), looks, settings.kind) for panel in shown]
    note = f"Each seed is smoothed: centred mean over {WINDOW} evaluations, fewer at the ends. Thin: not smoothed."
    return sheet(section, settings, slots, notes=[note, *iqm_notes(section, settings.kind)], lacking="no run")


def _slot(name: str, shown: Sequence[Series], looks: Looks, kind: IqmKind) -> Slot:
    smoothed = [replace(series, values=smooth(series.values, WINDOW)) for series in shown]
    slot = curves_slot(name, smoothed, looks, Statistics(kind=kind))

    def fill(axes: Axes) -> None:
        for series in shown:
            look = looks[series.label.method]._replace(marker="")
            line(axes, series.steps, iqm(scaled(series), kind, axis=0), look, linewidth=0.5, alpha=0.6)
        slot.fill(axes)

    return replace(slot, unit=f"{slot.unit}, smoothed", fill=fill)


def smooth(values: Floats, window: int) -> Floats:
    """Centred moving mean over an odd number of evaluations, along the last axis; the window shrinks evenly at both
    ends, so that no curve is shifted.
    """
    length = values.shape[-1]
    reach = [min(window // 2, at, length - 1 - at) for at in range(length)]
    means = [values[..., at - wide : at + wide + 1].mean(axis=-1) for at, wide in enumerate(reach)]
    return np.stack(means, axis=-1)


smoothed_curves = from_frames(draw)
