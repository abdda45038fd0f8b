"""Is the residual needed? For each prior the residual model on it beside SAC on the prior alone, one panel each.

Where an experiment has such pairs (`rrm-P` and `sac-P`), it draws what the learning curves show, a prior at a time.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import cells_sheet
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import contents, curves_cell, iqm_notes, methods, panel_name
from rrmctl.reports.series import Panel, Section, Series
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import ALONE, parts

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def suits(section: Section) -> bool:
    """Some prior has runs both with and without the residual."""
    return any(pairs(panel) for panel in section.panels())


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for each task and prior: the residual model, the prior alone, and what stands on no prior.

    Raises:
        UserError: no prior has runs of both.
    """
    panels, looks = section.panels(), section.looks()
    cells = [(panel, prior) for panel in panels for prior in pairs(panel)]
    if not cells:
        raise nothing(section, "no prior with runs both with and without the residual")
    shown = [_shown(panel, prior) for panel, prior in cells]
    return cells_sheet(
        title(section),
        [
            curves_cell(f"{panel_name(panel, panels)}: {prior}", series, looks, settings.kind)
            for (panel, prior), series in zip(cells, shown, strict=True)
        ],
        size=settings.width,
        handles=methods(itertools.chain(*shown), looks),
        notes=[
            "Filled: with the residual; hollow and dashed: the prior alone.",
            *iqm_notes(section, settings.kind),
            *contents(section),
        ],
    )


def pairs(panel: Panel) -> list[str]:
    """Priors that stand alone and under a residual, in the order of the plan."""
    known = [parts(each.label.method) for each in panel.present()]
    corrected = {prior for family, prior in known if family not in ("", ALONE)}
    return [prior for family, prior in known if family == ALONE and prior in corrected]


def _shown(panel: Panel, prior: str) -> list[Series]:
    """What stands on this prior, and what stands on none."""
    named = [(each, *parts(each.label.method)) for each in panel.present()]
    return [each for each, family, base in named if family == "" or base == prior]


ablation = FromFrames(draw)
