"""Learning curves: one panel for each task, the interquartile mean over seeds, their quartiles as a band.

The oracle is dotted. The band is the spread of the seeds (25th to 75th percentile), not a confidence interval.
"""

from __future__ import annotations

from rrmctl.reports.figure_layout import Figure, from_frames, sheet
from rrmctl.reports.plot_elements import curves_slot, iqm_notes, panel_name
from rrmctl.reports.report import final_notes
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, Statistics


def suits(section: Section) -> bool:
    """Every section with a run has curves."""
    return section.contained > 0


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """One panel for each task (and teacher and schedule), a line for each method."""
    panels, looks = section.panels(), section.looks()
    slots = [curves_slot(panel_name(panel, panels), panel.present(), looks, settings) for panel in panels]
    notes = [*iqm_notes(section, settings.kind), *final_notes(section, settings)]
    return sheet(section, settings, slots, notes=notes, lacking="no run")


learning_curves = from_frames(draw)
