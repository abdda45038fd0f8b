"""Box figure: every seed's score at the step at which a task's methods are compared, and why at that step.

Success is read at the first evaluation at which 80 % of the seeds of a method other than the oracle are at 100 %; the
panel above each box shows those shares. Where no method gets there, and for returns, it is the last evaluation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from rrmctl.labels import knows
from rrmctl.reports.figure_layout import Axes, Figure, Slot, from_frames, sheet
from rrmctl.reports.plot_elements import UNITS, FinalScores, line, read_at, readings, score_axis, step_axis
from rrmctl.reports.report import final_notes
from rrmctl.reports.series import Panel, Section, at_steps
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import MIN_RUNS, CommonStep, IqmKind, iqm, mean, quartiles
from rrmctl.stats.curves import SHARE

#: Inches: a method's row, and what a panel of boxes needs beside its rows.
_ROW, _FRAME = 0.25, 0.7
_GREY = "#555555"


def suits(section: Section) -> bool:
    """Some method has seeds enough for a spread, and no task has more than two schedules: those are less-feedback's."""
    panels = section.panels()
    schedules = Counter((panel.task, panel.teacher) for panel in panels)
    return max(schedules.values(), default=0) <= 2 and any(
        series.n >= MIN_RUNS and not knows(series.label.method)
        for panel in panels
        if panel.comparable()
        for series in panel.present()
    )


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """For each task the seeds, quartiles, mean and IQM of each method at the common step, and what chose it."""
    cells, looks = readings(section, Panel.read_at, settings.last), section.looks()
    names = list(dict.fromkeys(method for cell in cells for method in cell.strata if not knows(method)))
    return sheet(
        section,
        settings,
        [_slot(cell, names, looks, settings.kind) for cell in cells],
        notes=[*_notes(cells, settings.kind), *final_notes(section, settings, read_at(cells))],
        lacking="no runs that can be compared at one step",
        height=_FRAME + _ROW * len(names),
    )


def _slot(cell: FinalScores, names: Sequence[str], looks: Looks, kind: IqmKind) -> Slot:
    rule, when = None, "each at its step"
    if cell.read is not None:
        when = f"at step {cell.read.step:,}" + ("" if cell.read.reached else " (last)")
        if cell.score == "success":
            rule = partial(_draw_rule, panel=cell.panels[0], read=cell.read, looks=looks)
    fill = partial(_draw_boxes, cell=cell, names=names, looks=looks, kind=kind)
    unit = "Seeds at\n100 % (%)" if rule else ""
    runs = [(series.label.method, series.n) for panel in cell.panels for series in panel.present()]
    return Slot(f"{cell.name}\n{when}", unit, fill, UNITS[cell.score], runs, above=rule)


def _draw_rule(axes: Axes, panel: Panel, read: CommonStep, looks: Looks) -> None:
    """The share of seeds at 100 % over steps, the share that is asked for, and the step that this chooses."""
    steps = panel.steps()
    learners = [series for series in panel.present() if not knows(series.label.method)]
    for position, series in enumerate(learners):
        share = 100 * (at_steps(series, steps) >= 1.0).mean(axis=0)
        line(axes, steps, share, looks[series.label.method], position, linewidth=1.0, markersize=3)
    axes.axhline(100 * SHARE, color=_GREY, linewidth=0.8, linestyle=(0, (3, 2)))
    axes.axvline(read.step, color=_GREY, linewidth=0.8, linestyle="-" if read.reached else (0, (1, 2)))
    score_axis(axes, "success")
    axes.set_yticks([0, 100 * SHARE, 100])
    step_axis(axes, int(steps[-1]))
    axes.set_xlabel("Environment steps")


def _draw_boxes(axes: Axes, cell: FinalScores, names: Sequence[str], looks: Looks, kind: IqmKind) -> None:
    """A row for each method, the first on top; its mean stands at the right."""
    for row, method in enumerate(names):
        if method not in cell.strata:
            continue
        y, look, scores = len(names) - 1 - row, looks[method], cell.runs(method)
        center, (low, high) = float(mean(scores)), map(float, quartiles(scores))
        colours: Any = {"facecolor": f"{look.color}30", "edgecolor": look.color}
        axes.barh(y, high - low, left=low, height=0.62, linewidth=0.9, **colours)
        axes.plot([center, center], [y - 0.31, y + 0.31], color=look.color, linewidth=1.8, solid_capstyle="butt")
        heights = np.full(scores.size, float(y))  # equal scores lie beside one another
        for value in np.unique(scores):
            same = np.flatnonzero(scores == value)
            if same.size > 1:
                heights[same] += np.linspace(-0.24, 0.24, same.size)
        seeds: dict[str, Any] = look._asdict() | {"linestyle": "none", "marker": look.marker or "o"}
        axes.plot(scores, heights, markersize=2.8, markeredgewidth=0.5, alpha=0.85, clip_on=False, **seeds)
        diamond: Any = {"markersize": 4, "markeredgewidth": 1, "markerfacecolor": "white", "markeredgecolor": "black"}
        axes.plot(float(iqm(scores, kind)), y, "D", zorder=4, clip_on=False, **diamond)
        text = f"{center:.1f}" if cell.score == "success" else f"{center:,.0f}"
        axes.annotate(text, (1.05, y), xycoords=("axes fraction", "data"), va="center", fontsize="small")
    for oracle in filter(knows, cell.strata):
        dots, center = looks[oracle], float(mean(cell.runs(oracle)))
        axes.axvline(center, color=dots.color, linestyle=dots.linestyle, linewidth=1.2, zorder=1)
    if cell.score == "success":
        axes.set_xlim(-4, 104)
    axes.set_ylim(-0.6, len(names) - 0.4)
    place = axes.get_subplotspec()
    shown = list(reversed(names)) if place and place.is_first_col() else [""] * len(names)
    axes.set_yticks(range(len(names)), shown)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")


def _notes(cells: Sequence[FinalScores], kind: IqmKind) -> Iterator[str]:
    yield (
        f"Points: seeds. Box: 25 to 75 % of them. Line and number: mean. Diamond: interquartile mean ({kind}). "
        "Dotted: the oracle's mean."
    )
    ruled = {cell.name: cell.read for cell in cells if cell.read is not None and cell.score == "success"}
    if ruled:
        yield (
            f"Step: the first evaluation at which {100 * SHARE:g} % of the seeds (dashed) of a method other than the "
            "oracle are at 100 %, a choice that flatters all methods alike; else the last one."
        )
    for name, read in ruled.items():
        yield f"{name}: reached by {' and '.join(read.by) if read.reached else 'none'}."
    if any(cell.score == "return" for cell in cells):
        yield "Returns are read at the last step."


box_plot = from_frames(draw)
