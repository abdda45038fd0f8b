"""What the panels of several figures are drawn with: lines with bands, the axis of steps, names in the legend."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.labels import ORACLE
from rrmctl.reports.captions import absent_notes
from rrmctl.reports.figure_layout import Slot
from rrmctl.reports.series import Panel, Section, Series
from rrmctl.reports.styles import LINE, Looks, Style
from rrmctl.stats import Floats, Steps, iqm, quartiles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rrmctl.stats import IqmKind

UNITS = {"success": "Success rate (%)", "return": "Return (true reward)"}

_MARKERS_A_LINE = 8


def line(axes: Axes, steps: Steps | Floats, values: Floats, look: Style, position: int = 0, **other: Any) -> None:
    """A line with some eight markers; those of lines at different positions do not lie on one another."""
    every = math.ceil(steps.size / _MARKERS_A_LINE)
    # A line without markers has nothing to show at a single step.
    marker = look.marker or ("." if steps.size == 1 else "")
    arguments: dict[str, Any] = look._asdict() | {"marker": marker, "markevery": (position % every, every)}
    axes.plot(steps, values, **LINE | arguments | other)


def band(axes: Axes, steps: Steps, values: Floats, look: Style) -> None:
    """The quartiles of the seeds, values [S, T]; nothing for a single seed."""
    if len(values) > 1:
        low, high = quartiles(values, axis=0)
        axes.fill_between(steps, low, high, color=look.color, alpha=0.14, linewidth=0)


def curve(axes: Axes, series: Series, look: Style, kind: IqmKind, position: int) -> None:
    """A series' interquartile mean and quartiles, success in percent."""
    values = scaled(series)
    on_top = 3 if series.label.method == ORACLE else 2  # dots on a line can be seen, a line on dots hides them
    line(axes, series.steps, iqm(values, kind, axis=0), look, position, zorder=on_top)
    band(axes, series.steps, values, look)


def curves_cell(name: str, series: Sequence[Series], looks: Looks, kind: IqmKind) -> Slot:
    """A panel of learning curves of one score."""

    def fill(axes: Axes) -> None:
        for position, each in enumerate(series):
            curve(axes, each, looks[each.label.method], kind, position)
        score_axis(axes, series[0].score)
        step_axis(axes, max(int(each.steps[-1]) for each in series))

    return Slot(name, UNITS[series[0].score], fill)


def scaled(series: Series) -> Floats:
    """The series' scores as axes show them, [S, T]: success in percent, returns as they are."""
    return 100 * series.values if series.score == "success" else series.values


def methods(series: Iterable[Series], looks: Looks) -> dict[str, Style]:
    """The legend: an entry for each method, with the number of seeds behind its lines."""
    found: dict[str, set[int]] = {}
    for each in series:
        found.setdefault(each.label.method, set()).add(each.n)
    ends = {method: dict.fromkeys((min(counts), max(counts))) for method, counts in found.items()}
    return {f"{method} (n = {'–'.join(map(str, counts))})": looks[method] for method, counts in ends.items()}


def step_axis(axes: Axes, last: int) -> None:
    """From zero to the last step, with ticks like 500k."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    axes.set_xlim(0, 1.03 * last)
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda steps, _: told(steps)))


def score_axis(axes: Axes, score: str) -> None:
    """Success has the same axis everywhere."""
    if score == "success":
        axes.set_ylim(-4, 104)
        axes.set_yticks(range(0, 101, 20))


def told(steps: float) -> str:
    """A number of steps in short: 0, 500, 50k, 1.5M."""
    if abs(steps) >= 1e6:
        return f"{steps / 1e6:g}M"
    return f"{steps / 1e3:g}k" if abs(steps) >= 1e3 else f"{steps:g}"


def panel_name(panel: Panel, panels: Sequence[Panel]) -> str:
    """The task, and what else tells the panel from the others of its task."""
    others = [each for each in panels if each.task == panel.task]
    parts = [panel.task]
    if len({each.teacher for each in others}) > 1:
        parts.append(f"teacher {panel.teacher}")
    if len({each.feedback for each in others}) > 1:
        parts.append(panel.feedback)
    return ", ".join(parts)


def iqm_notes(section: Section, kind: IqmKind) -> Iterator[str]:
    """What lines and bands are."""
    yield f"Line: interquartile mean over seeds ({kind})."
    if any(each.n > 1 for each in section.series):
        yield "Band: 25 to 75 % of the seeds."


def contents(section: Section) -> Iterator[str]:
    """Notes of every figure: how many of the planned runs it contains, which are missing, what was left out."""
    yield f"{section.contained} of {section.planned} planned runs."
    yield from absent_notes(section, short=True)
    yield from section.problems
