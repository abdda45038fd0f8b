"""Less feedback: success against the size of a session, and against the steps between two, a point for each budget.

A point is the mean over the evaluation steps of the interquartile mean over seeds, with its bootstrap interval; the
small hollow one above or below it is the interquartile mean at the last step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rrmctl.reports.marks import UNITS, contents, methods, score_axis, told
from rrmctl.reports.notebook import from_frames, nothing
from rrmctl.reports.series import NOTHING_ASKED, Floats, Section, Series, at_steps
from rrmctl.reports.settings import BOOTSTRAP_SEED, DEFAULTS, LEVEL, Settings
from rrmctl.reports.sheet import Cell, cells_sheet
from rrmctl.reports.styles import Style, style
from rrmctl.reports.tables import ALL_TASKS
from rrmctl.reports.words import title
from rrmctl.stats import Estimate, Iqm, estimate, interval_possible, iqm, resample

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABEL = re.compile(r"(\d+)@(\d+)/(\d+)")


class Schedule(NamedTuple):
    """Of feedback, as its label says."""

    batch: int  #: queries of a session
    every: int  #: steps between sessions
    budget: int  #: queries in all


@dataclass(frozen=True, eq=False)
class Sweep:
    """The schedules of one task and teacher that differ in one respect."""

    task: str
    teacher: str
    field: str  #: of `Schedule`, in which they differ
    schedules: tuple[Schedule, ...]  #: from most feedback to least
    series: dict[tuple[str, Schedule], Series]  #: by method and schedule


def suits(section: Section) -> bool:
    """Some task is asked under schedules that differ in one respect alone."""
    return bool(sweeps(section))


def draw(section: Section, settings: Settings = DEFAULTS) -> Figure:
    """For each task, and for all success tasks together, a panel for each respect in which schedules differ.

    Raises:
        UserError: no task has schedules to compare.
    """
    found = sweeps(section)
    if not found:
        raise nothing(section, "no schedules of feedback that could be compared")
    groups = [[each] for each in found] + _pools(found)
    return cells_sheet(
        title(section),
        [_cell(group, found, settings) for group in groups],
        size=settings.width,
        handles=methods(series for each in found for series in each.series.values()),
        notes=[
            f"Points: mean over the evaluation steps of the interquartile mean over seeds ({settings.kind}), with its "
            f"{100 * LEVEL:g} % bootstrap interval. Small and hollow: the interquartile mean at the last step.",
            *contents(section),
        ],
        most=4,
    )


def sweeps(section: Section) -> list[Sweep]:
    """The comparisons of schedules that the section holds, task by task."""
    asked: dict[tuple[str, str], dict[tuple[str, Schedule], Series]] = {}
    for series in section.series:
        match = _LABEL.fullmatch(series.label.feedback)
        if match and series.n and series.label.teacher != NOTHING_ASKED:
            schedule = Schedule(*(int(group) for group in match.groups()))
            asked.setdefault(series.label[:1] + series.label[2:3], {})[series.label.method, schedule] = series
    return [sweep for (task, teacher), series in asked.items() for sweep in _of_task(task, teacher, series)]


def _of_task(task: str, teacher: str, series: dict[tuple[str, Schedule], Series]) -> Iterator[Sweep]:
    """Sweeps over the size of a session at the shortest wait, and over the wait at the largest session."""
    schedules = {schedule for _, schedule in series}
    batch, every = max(each.batch for each in schedules), min(each.every for each in schedules)
    for field, chosen in (
        ("batch", sorted((each for each in schedules if each.every == every), reverse=True)),
        ("every", sorted((each for each in schedules if each.batch == batch), key=lambda each: each.every)),
    ):
        if len({getattr(each, field) for each in chosen}) == len(chosen) > 1:
            own = {key: each for key, each in series.items() if key[1] in chosen}
            yield Sweep(task, teacher, field, tuple(chosen), own)


def _pools(found: Sequence[Sweep]) -> list[list[Sweep]]:
    """Sweeps of several success tasks over the same schedules under the same teacher."""
    groups: dict[Any, list[Sweep]] = {}
    for each in found:
        if all(series.score == "success" for series in each.series.values()):
            groups.setdefault((each.field, each.teacher, each.schedules), []).append(each)
    return [group for group in groups.values() if len(group) > 1]


def _cell(group: Sequence[Sweep], found: Sequence[Sweep], settings: Settings) -> Cell:
    """A panel: one task, or several pooled."""
    first = group[0]
    name = first.task if len(group) == 1 else ALL_TASKS
    teachers = {each.teacher for each in found}
    if len(teachers) > 1:
        name += f", teacher {first.teacher}"
    score = next(iter(first.series.values())).score
    if first.field == "batch":
        across = f"Queries a session,\nevery {told(first.schedules[0].every)} steps"
    else:
        across = f"Steps between\nsessions of {first.schedules[0].batch}"
    return Cell(name, UNITS[score], _filler(group, score, settings), across)


def _filler(group: Sequence[Sweep], score: str, settings: Settings) -> Callable[[Axes], None]:
    first, scale = group[0], 100 if score == "success" else 1
    names = list(dict.fromkeys(method for method, _ in first.series))

    def fill(axes: Axes) -> None:
        for row, method in enumerate(names):
            shift = 0.12 * (row - (len(names) - 1) / 2)
            have = [at for at, each in enumerate(first.schedules) if all((method, each) in s.series for s in group)]
            made = [mean_of_iqm([s.series[method, first.schedules[at]] for s in group], settings) for at in have]
            _draw_points(axes, np.array(have) + shift, made, scale, style(method))
        axes.set_xticks(range(len(first.schedules)), [told(getattr(each, first.field)) for each in first.schedules])
        axes.set_xlim(-0.4, len(first.schedules) - 0.6)
        score_axis(axes, score)

    return fill


def _draw_points(axes: Axes, x: Floats, made: Sequence[tuple[Estimate, float]], scale: float, look: Style) -> None:
    """Means with their intervals on a line, and the last steps' values, small and hollow, on none."""
    means, last = [each for each, _ in made], [scale * final for _, final in made]
    y, low, high = (scale * np.array([float(getattr(e, part)) for e in means]) for part in ("estimate", "low", "high"))
    axes.plot(x, y, linewidth=1.3, markersize=4, markeredgewidth=0.8, **look._asdict())
    axes.vlines(x, low, high, color=look.color, linewidth=0.9)
    hollow = look._asdict() | {"linestyle": "none", "markerfacecolor": "white"}
    axes.plot(x, last, markersize=3, markeredgewidth=0.6, **hollow)


def mean_of_iqm(strata: Sequence[Series], settings: Settings) -> tuple[Estimate, float]:
    """Mean over the steps that all have of the IQM of their seeds pooled, and the IQM at the last of these steps."""
    steps = reduce(np.intersect1d, (each.steps for each in strata))
    values = [at_steps(each, steps) for each in strata]
    point = iqm(np.concatenate(values), settings.kind, axis=0)
    draws = None
    if interval_possible([each.n for each in strata]):
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        draws = resample(values, Iqm(settings.kind), rng=rng, replicates=settings.replicates).mean(axis=-1)
    return estimate(point.mean(), draws, n=sum(each.n for each in strata), level=LEVEL), float(point[-1])


less_feedback = from_frames(draw)
