"""Learning curves: one panel for each task, the interquartile mean over seeds, their quartiles as a band.

The oracle is dotted. The band is the spread of the seeds (25th to 75th percentile), not a confidence interval.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import cells_sheet
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import contents, curves_cell, iqm_notes, methods, panel_name
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, Statistics

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def suits(section: Section) -> bool:
    """Every section with a run has curves."""
    return section.contained > 0


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """One panel for each task (and teacher and schedule), a line for each method.

    Raises:
        UserError: it has no run to show.
    """
    panels, looks = section.panels(), section.looks()
    if not panels:
        raise nothing(section, "no run")
    return cells_sheet(
        title(section),
        [curves_cell(panel_name(panel, panels), panel.present(), looks, settings.kind) for panel in panels],
        size=settings.width,
        handles=methods((each for panel in panels for each in panel.present()), looks),
        notes=[*iqm_notes(section, settings.kind), *contents(section)],
    )


learning_curves = FromFrames(draw)
