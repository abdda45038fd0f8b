"""Is the residual needed? For each prior the residual model on it beside the agent on the prior alone, one panel each.

Where an experiment has such pairs (`rrm-P` and `sac-P`, or `drqv2-P`), it draws what the learning curves show, a prior
at a time.
"""

from __future__ import annotations

from rrmctl.reports.figure_layout import Figure, from_frames, sheet
from rrmctl.reports.plot_elements import curves_slot, iqm_notes, panel_name
from rrmctl.reports.report import final_notes
from rrmctl.reports.series import Panel, Section, Series
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import ALONE, parts


def suits(section: Section) -> bool:
    """Some prior has runs both with and without the residual."""
    return any(map(pairs, section.panels()))


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for each task and prior: the residual model, the prior alone, and what stands on no prior."""
    panels, looks = section.panels(), section.looks()
    slots = [
        curves_slot(f"{panel_name(panel, panels)}: {prior}", series, looks, settings)
        for panel in panels
        for prior, series in pairs(panel).items()
    ]
    notes = ["Filled: with the residual; hollow and dashed: the prior alone.", *iqm_notes(section, settings.kind)]
    notes += final_notes(section, settings)
    lacking = "no prior with runs both with and without the residual"
    return sheet(section, settings, slots, notes=notes, lacking=lacking)


def pairs(panel: Panel) -> dict[str, list[Series]]:
    """For priors that stand alone and under a residual: what stands on this one, and what stands on none."""
    named = [(series, *parts(series.label.method)) for series in panel.present()]
    corrected = {prior for _, family, prior in named if family not in ("", *ALONE)}
    return {
        prior: [series for series, other, base in named if other == "" or base == prior]
        for _, family, prior in named
        if family in ALONE and prior in corrected
    }


ablation = from_frames(draw)
