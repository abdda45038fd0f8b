"""Learning from people: each seed's curve smoothed, then the interquartile mean and quartiles over seeds.

People answer for few seeds, whose curves jump; the window is told below the figure, and a thin line is not smoothed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Slot, cells_sheet
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import (
    UNITS,
    contents,
    curve,
    iqm_notes,
    line,
    methods,
    panel_name,
    scaled,
    score_axis,
    step_axis,
)
from rrmctl.reports.series import Panel, Section
from rrmctl.reports.smoothing import smooth
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import iqm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rrmctl.stats import IqmKind

#: Evaluations.
WINDOW = 5
#: The teacher that is a person.
HUMAN = "human"


def suits(section: Section) -> bool:
    """People taught in some of its runs."""
    return any(panel.teacher == HUMAN for panel in section.panels())


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """Smoothed learning curves, a panel for each task that people taught (of every task, where they taught none).

    Raises:
        UserError: there are no runs.
    """
    panels, looks = section.panels(), section.looks()
    shown = [panel for panel in panels if panel.teacher == HUMAN] or panels
    if not shown:
        raise nothing(section, "no run")
    return cells_sheet(
        title(section),
        [_cell(panel_name(panel, panels), panel, looks, settings.kind) for panel in shown],
        size=settings.width,
        handles=methods((each for panel in shown for each in panel.present()), looks),
        notes=[
            f"Each seed is smoothed: centred mean over {WINDOW} evaluations, fewer at the ends. Thin: not smoothed.",
            *iqm_notes(section, settings.kind),
            *contents(section),
        ],
    )


def _cell(name: str, panel: Panel, looks: Looks, kind: IqmKind) -> Slot:
    def fill(axes: Axes) -> None:
        for position, each in enumerate(panel.present()):
            look = looks[each.label.method]
            line(axes, each.steps, iqm(scaled(each), kind, axis=0), look._replace(marker=""), linewidth=0.5, alpha=0.6)
            curve(axes, replace(each, values=smooth(each.values, WINDOW)), look, kind, position)
        score_axis(axes, panel.score)
        step_axis(axes, max(int(each.steps[-1]) for each in panel.present()))

    return Slot(name, f"{UNITS[panel.score]}, smoothed", fill)


smoothed_curves = FromFrames(draw)
