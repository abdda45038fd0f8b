"""Learning curves: one panel for each task, the interquartile mean over seeds, their quartiles as a band.

The oracle is dotted. The band is the spread of the seeds (25th to 75th percentile), not a confidence interval.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.reports.canvas import LOOK
from rrmctl.reports.select import sections
from rrmctl.reports.series import ORACLE, Panel, Section, Series
from rrmctl.reports.settings import DEFAULTS, Settings
from rrmctl.reports.styles import style
from rrmctl.reports.words import absent_notes, title
from rrmctl.stats import iqm, quartiles

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from rrmctl.stats import IqmKind

#: Inches. Three panels fill the width of a page.
_PANEL = (2.45, 1.95)
_SINGLE = (4.6, 3.0)
_ACROSS = 3
_MARKERS_A_LINE = 8
_LINE: dict[str, Any] = {"linewidth": 1.3, "markersize": 3.6, "markeredgewidth": 0}
#: In font sizes. Long handles, or the marker would hide the gap of a dashed line.
_LEGEND: dict[str, Any] = {"borderaxespad": 0.2, "columnspacing": 1.4, "handlelength": 3.2}

_UNITS = {"success": "Success rate (%)", "return": "Return (true reward)"}


def learning_curves(rows: pd.DataFrame, jobs: pd.DataFrame | None = None, *, kind: IqmKind = "rliable") -> Figure:
    """One panel for each task (and teacher and schedule), a line for each method.

    Args:
        rows: one variant of one experiment, as `rrmctl.store.load` returns it.
        jobs: as `rrmctl.store.planned`, to say which runs are missing.
        kind: of interquartile mean.

    Raises:
        UserError: several variants or experiments at once, runs that do not belong together, or none at all.
    """
    found = sections(rows, jobs)
    if len(found) != 1:
        which = ", ".join(f"{each.experiment}/{each.variant}" for each in found) or "none"
        raise UserError(f"a figure shows one variant of one experiment, not {which}", "filter the rows beforehand")
    return draw(found[0], Settings(kind=kind))


def suits(section: Section) -> bool:
    """Every section with a run has curves."""
    return section.contained > 0


def draw(section: Section, settings: Settings = DEFAULTS) -> Figure:
    """The learning curves of a section.

    Raises:
        UserError: it has no run to show.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    panels, kind = section.panels(), settings.kind
    if not panels:
        raise UserError(
            f"{section.experiment}: there is no run to draw", f"`rrmctl run {section.experiment}` makes one"
        )
    across = min(len(panels), _ACROSS)
    down = math.ceil(len(panels) / across)
    width, height = (across * _PANEL[0], down * _PANEL[1] + 0.3) if len(panels) > 1 else _SINGLE
    counts = _counts(panels)
    columns = _legend_columns(list(counts.values()), width)
    notes = _notes(section, kind, width)
    below = 0.12 + 0.17 * math.ceil(len(counts) / columns) + 0.125 * len(notes)
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(width, height + below), layout="constrained")
        strips: Any = figure.subfigures(2, 1, height_ratios=(height, below))
        upper, lower = strips
        upper.suptitle(title(section), fontsize=9)
        grid = upper.subplots(down, across, squeeze=False)
        for position, axes in enumerate(grid.flat):
            if position >= len(panels):
                axes.set_visible(False)
                continue
            panel = panels[position]
            _draw_panel(axes, panel, kind)
            axes.set_title(_panel_title(panel, panels))
            if position + across >= len(panels):
                axes.set_xlabel("Environment steps")
            if position % across == 0 or panels[position - 1].score != panel.score:
                axes.set_ylabel(_UNITS[panel.score])
        handles = [_handle(method, label) for method, label in counts.items()]
        lower.legend(handles=handles, loc="upper center", ncols=columns, **_LEGEND)
        lower.text(0.5, 0.03, "\n".join(notes), ha="center", va="bottom", fontsize=6.5, color="#444444")
    return figure


def _draw_panel(axes: Axes, panel: Panel, kind: IqmKind) -> None:
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    for position, series in enumerate(panel.present()):
        _draw_series(axes, series, kind, position)
    if panel.score == "success":
        axes.set_ylim(-4, 104)
    axes.set_xlim(0, 1.02 * max(int(series.steps[-1]) for series in panel.present()))
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda steps, _: _steps(steps)))


def _draw_series(axes: Axes, series: Series, kind: IqmKind, position: int) -> None:
    look = style(series.label.method)
    scale = 100 if series.score == "success" else 1
    every = math.ceil(series.steps.size / _MARKERS_A_LINE)
    # The oracle is told apart by its dots alone, but a single evaluation has no line to dot.
    marker = look.marker or ("." if series.steps.size == 1 else "")
    on_top = 3 if series.label.method == ORACLE else 2  # dots on a line can be seen, a line on dots hides them
    axes.plot(
        series.steps,
        scale * iqm(series.values, kind, axis=0),
        color=look.color,
        linestyle=look.linestyle,
        marker=marker,
        zorder=on_top,
        markevery=(position % every, every),  # staggered, so that lines on top of one another can be told apart
        **_LINE,
    )
    if series.n > 1:
        low, high = quartiles(series.values, axis=0)
        axes.fill_between(series.steps, scale * low, scale * high, color=look.color, alpha=0.14, linewidth=0)


def _handle(method: str, label: str) -> Line2D:
    from matplotlib.lines import Line2D

    look = style(method)
    return Line2D([], [], color=look.color, linestyle=look.linestyle, marker=look.marker, label=label, **_LINE)


def _counts(panels: Sequence[Panel]) -> dict[str, str]:
    """Method -> its name in the legend, with the number of seeds behind its lines."""
    found: dict[str, set[int]] = {}
    for series in (each for panel in panels for each in panel.present()):
        found.setdefault(series.label.method, set()).add(series.n)
    ends = {method: dict.fromkeys((min(counts), max(counts))) for method, counts in found.items()}
    return {method: f"{method} (n = {'–'.join(map(str, counts))})" for method, counts in ends.items()}


def _legend_columns(labels: Sequence[str], width: float) -> int:
    """As many columns as fit into `width` inches, at the legend's font size of 8 points."""
    handle, letter, gap = 0.47, 0.058, 0.16
    for columns in range(len(labels), 1, -1):
        rows, longer = divmod(len(labels), columns)  # matplotlib gives its first columns one more
        starts = [column * rows + min(column, longer) for column in range(columns + 1)]
        widest = [max(map(len, labels[start:end])) for start, end in itertools.pairwise(starts)]
        if sum(handle + letter * letters + gap for letters in widest) - gap <= width:
            return columns
    return 1


def _panel_title(panel: Panel, panels: Sequence[Panel]) -> str:
    """The task, and what else tells the panel from the others of its task."""
    others = [each for each in panels if each.task == panel.task]
    parts = [panel.task]
    if len({each.teacher for each in others}) > 1:
        parts.append(f"teacher {panel.teacher}")
    if len({each.feedback for each in others}) > 1:
        parts.append(panel.feedback)
    return ", ".join(parts)


def _notes(section: Section, kind: IqmKind, width: float) -> list[str]:
    sentences = [
        f"Line: interquartile mean over seeds ({kind}).",
        *(["Band: 25 to 75 % of the seeds."] if any(each.n > 1 for each in section.series) else []),
        f"{section.contained} of {section.planned} planned runs.",
        *absent_notes(section),
        *section.problems,
    ]
    return textwrap.wrap(" ".join(sentences), int(width * 22))


def _steps(steps: float) -> str:
    """A tick's label: 0, 500, 50k, 1.5M."""
    if abs(steps) >= 1e6:
        return f"{steps / 1e6:g}M"
    return f"{steps / 1e3:g}k" if abs(steps) >= 1e3 else f"{steps:g}"
