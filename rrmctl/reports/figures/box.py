"""Box figure: every seed's score at the step at which a task's methods are compared, and why at that step.

Success is read at the first evaluation at which 80 % of the seeds of a method other than the oracle are at 100 %; the
panel above each box shows those shares. Where no method gets there, and for returns, it is the last evaluation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rrmctl.labels import knows
from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Shape, panel_title, shape, sheet
from rrmctl.reports.final_scores import FinalScores, readings
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import UNITS, contents, line, methods, score_axis, step_axis
from rrmctl.reports.series import Panel, Section, at_steps
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import Looks, Style
from rrmctl.stats import MIN_RUNS, Floats, iqm, mean, quartiles
from rrmctl.stats.curves import SHARE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rrmctl.stats import IqmKind

#: Inches: the panel that shows the rule, a method's row, and what a panel of boxes needs beside its rows.
_RULE, _ROW, _FRAME = 1.4, 0.25, 0.7
_GREY = "#555555"
_DIAMOND: dict[str, Any] = {"marker": "D", "markersize": 4, "markerfacecolor": "white", "markeredgecolor": "black"}


def suits(section: Section) -> bool:
    """Some method has seeds enough for a spread, and no task has several schedules: those are less-feedback's."""
    panels = section.panels()
    schedules = {(panel.task, panel.teacher) for panel in panels}
    return len(schedules) == len(panels) and any(
        each.n >= MIN_RUNS and not knows(each.label.method)
        for panel in panels
        if panel.comparable()
        for each in panel.present()
    )


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """For each task the seeds, quartiles, mean and IQM of each method at the common step, and the rule that chose it.

    Raises:
        UserError: there are no runs, or none that can be compared.
    """
    cells, looks = readings(section, Panel.read_at), section.looks()
    if not cells:
        raise nothing(section, "no runs that can be compared at one step")
    form = shape(len(cells), settings.width)
    rows = [cells[start : start + form.across] for start in range(0, len(cells), form.across)]
    names = list(dict.fromkeys(method for cell in cells for method in cell.strata if not knows(method)))
    boxes = _FRAME + _ROW * len(names)
    heights = [height for row in rows for height in ((_RULE, boxes) if any(map(_ruled, row)) else (boxes,))]
    with sheet(
        title(section),
        heights,
        form.across,
        size=settings.width,
        width=form.width,
        handles=methods((each for cell in cells for panel in cell.panels for each in panel.present()), looks),
        notes=[*_notes(cells, settings.kind), *contents(section)],
    ) as (figure, grid):
        lines = iter(grid)
        for row in rows:
            rules = next(lines) if any(map(_ruled, row)) else []
            _draw_row(row, rules, next(lines), names, looks, form=form, settings=settings)
    return figure


def _ruled(cell: FinalScores) -> bool:
    """Whether the step was chosen by the share of seeds at 100 %."""
    return cell.read is not None and cell.score == "success"


def _draw_row(
    cells: Sequence[FinalScores],
    rules: Sequence[Axes],
    boxes: Sequence[Axes],
    names: Sequence[str],
    looks: Looks,
    *,
    form: Shape,
    settings: Statistics,
) -> None:
    for axes in (*rules, *boxes):
        axes.set_visible(False)
    for position, cell in enumerate(cells):
        top = boxes[position]
        if _ruled(cell):
            top = rules[position]
            _draw_rule(top, cell, looks)
            if position == 0:
                top.set_ylabel("Seeds at\n100 % (%)")
        _draw_boxes(boxes[position], cell, names, looks, settings.kind)
        if position > 0:
            boxes[position].set_yticklabels([])
        panel_title(top, _title(cell), form.width / form.across, settings.width)


def _title(cell: FinalScores) -> str:
    if cell.read is None:
        return f"{cell.name}\neach at its step"
    return f"{cell.name}\nat step {cell.read.step:,}" + ("" if cell.read.reached else " (last)")


def _draw_rule(axes: Axes, cell: FinalScores, looks: Looks) -> None:
    """The share of seeds at 100 % over steps, the share that is asked for, and the step that this chooses."""
    (panel,), read = cell.panels, cell.read
    assert read is not None
    steps = panel.steps()
    learners = [each for each in panel.present() if not knows(each.label.method)]
    for position, series in enumerate(learners):
        share = 100 * (at_steps(series, steps) >= 1.0).mean(axis=0)
        line(axes, steps, share, looks[series.label.method], position, linewidth=1.0, markersize=3)
    axes.axhline(100 * SHARE, color=_GREY, linewidth=0.8, linestyle=(0, (3, 2)))
    axes.axvline(read.step, color=_GREY, linewidth=0.8, linestyle="-" if read.reached else (0, (1, 2)))
    score_axis(axes, "success")
    axes.set_yticks([0, 100 * SHARE, 100])
    step_axis(axes, int(steps[-1]))
    axes.set_xlabel("Environment steps")
    axes.set_visible(True)


def _draw_boxes(axes: Axes, cell: FinalScores, names: Sequence[str], looks: Looks, kind: IqmKind) -> None:
    """A row for each method, the first on top; its mean stands at the right."""
    for row, method in enumerate(names):
        if method in cell.strata:
            _draw_box(axes, len(names) - 1 - row, cell.runs(method), looks[method], score=cell.score, kind=kind)
    for oracle in filter(knows, cell.strata):
        dots = looks[oracle]
        axes.axvline(
            float(mean(cell.runs(oracle))), color=dots.color, linestyle=dots.linestyle, linewidth=1.2, zorder=1
        )
    if cell.score == "success":
        axes.set_xlim(-4, 104)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.set_yticks(range(len(names)), reversed(names))
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(UNITS[cell.score])
    axes.set_visible(True)


def _draw_box(axes: Axes, y: int, scores: Floats, look: Style, *, score: str, kind: IqmKind) -> None:
    center = float(mean(scores))
    low, high = (float(edge) for edge in quartiles(scores))
    axes.barh(y, high - low, left=low, height=0.62, facecolor=f"{look.color}30", edgecolor=look.color, linewidth=0.9)
    axes.plot([center, center], [y - 0.31, y + 0.31], color=look.color, linewidth=1.8, solid_capstyle="butt")
    axes.plot(
        scores, y + _spread(scores), linestyle="none", marker=look.marker or "o", markersize=2.8, color=look.color,
        markerfacecolor=look.markerfacecolor, markeredgewidth=0.5, alpha=0.85, clip_on=False,
    )  # fmt: skip
    axes.plot(float(iqm(scores, kind)), y, linestyle="none", zorder=4, clip_on=False, **_DIAMOND)
    told = f"{center:.1f}" if score == "success" else f"{center:,.0f}"
    axes.annotate(told, (1.05, y), xycoords=("axes fraction", "data"), va="center", ha="left", fontsize="small")


def _spread(scores: Floats) -> Floats:
    """Heights at which equal scores lie beside one another, [S] within 0.24 of the row's middle."""
    heights = np.zeros(scores.size)
    for value in np.unique(scores):
        same = np.flatnonzero(scores == value)
        heights[same] = np.linspace(-0.24, 0.24, same.size) if same.size > 1 else 0.0
    return heights


def _notes(cells: Sequence[FinalScores], kind: IqmKind) -> Iterator[str]:
    yield (
        f"Points: seeds. Box: 25 to 75 % of them. Line and number: mean. Diamond: interquartile mean ({kind}). "
        "Dotted: the oracle's mean."
    )
    ruled = [cell for cell in cells if _ruled(cell)]
    if ruled:
        yield (
            f"Step: the first evaluation at which {100 * SHARE:g} % of the seeds (dashed) of a method other than the "
            "oracle are at 100 %, a choice that flatters all methods alike; else the last one."
        )
    for cell in ruled:
        if cell.read is not None:
            who = f"reached by {' and '.join(cell.read.by)}" if cell.read.reached else "reached by none"
            yield f"{cell.name}: {who}."
    if any(cell.score == "return" for cell in cells):
        yield "Returns are read at the last step."


box_plot = FromFrames(draw)
