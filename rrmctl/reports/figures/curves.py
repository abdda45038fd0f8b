"""Learning curves: one panel for each task, the interquartile mean over seeds, their quartiles as a band.

The oracle is dotted. The band is the spread of the seeds (25th to 75th percentile), not a confidence interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rrmctl.errors import UserError
from rrmctl.reports.marks import UNITS, contents, curve, methods, panel_name, score_axis, step_axis
from rrmctl.reports.notebook import from_frames
from rrmctl.reports.series import Panel, Section
from rrmctl.reports.settings import DEFAULTS, Settings
from rrmctl.reports.sheet import Shape, panel_title, shape, sheet
from rrmctl.reports.words import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rrmctl.stats import IqmKind


def suits(section: Section) -> bool:
    """Every section with a run has curves."""
    return section.contained > 0


def draw(section: Section, settings: Settings = DEFAULTS) -> Figure:
    """One panel for each task (and teacher and schedule), a line for each method.

    Raises:
        UserError: it has no run to show.
    """
    panels = section.panels()
    if not panels:
        raise UserError(
            f"{section.experiment}: there is no run to draw", f"`rrmctl run {section.experiment}` makes one"
        )
    form = shape(len(panels), settings.width)
    with sheet(
        title(section),
        [form.height] * form.down,
        form.across,
        size=settings.width,
        width=form.width,
        handles=methods(each for panel in panels for each in panel.present()),
        notes=[*iqm_notes(section, settings.kind), *contents(section)],
    ) as (figure, grid):
        for position, axes in enumerate(grid.flat):
            axes.set_visible(position < len(panels))
            if position < len(panels):
                _draw_panel(axes, position, panels, form, settings)
    return figure


def _draw_panel(axes: Axes, position: int, panels: Sequence[Panel], form: Shape, settings: Settings) -> None:
    panel = panels[position]
    for place, series in enumerate(panel.present()):
        curve(axes, series, settings.kind, place)
    score_axis(axes, panel.score)
    step_axis(axes, max(int(series.steps[-1]) for series in panel.present()), 6 if form.across < 3 else 5)
    panel_title(axes, panel_name(panel, panels), form.width / form.across, settings.width)
    if position + form.across >= len(panels):
        axes.set_xlabel("Environment steps")
    if position % form.across == 0 or panels[position - 1].score != panel.score:
        axes.set_ylabel(UNITS[panel.score])


def iqm_notes(section: Section, kind: IqmKind) -> Iterator[str]:
    """What lines and bands are."""
    yield f"Line: interquartile mean over seeds ({kind})."
    if any(each.n > 1 for each in section.series):
        yield "Band: 25 to 75 % of the seeds."


learning_curves = from_frames(draw)
