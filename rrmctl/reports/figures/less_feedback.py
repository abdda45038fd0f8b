"""Less feedback: success against the size of a session, and against the steps between two, a point for each budget.

A point is the mean over the evaluation steps of the interquartile mean over seeds, with its bootstrap interval; the
small hollow one above or below it is the interquartile mean at the last step. Of several tasks it is their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rrmctl.errors import UserError
from rrmctl.labels import NOTHING_ASKED
from rrmctl.planning.schedules import Schedule
from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Slot, cells_sheet
from rrmctl.reports.iqm_curves import ALL_TASKS
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import UNITS, contents, methods, score_axis, told
from rrmctl.reports.scores import read_together, score
from rrmctl.reports.series import Section, Series
from rrmctl.reports.statistics import DEFAULTS, SURE, Statistics
from rrmctl.reports.styles import Looks, Style
from rrmctl.stats import Estimate, Floats, iqm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """For each task, and for the mean of the success tasks, a panel for each respect in which schedules differ.

    Raises:
        UserError: no task has schedules to compare.
    """
    values, apart = _read(section)
    found, looks = sweeps(section), section.looks()
    if not found:
        raise nothing(section, "no schedules of feedback that could be compared")
    means = _means(found)
    return cells_sheet(
        title(section),
        [_cell(group, found, values, looks, settings) for group in ([[each] for each in found] + means)],
        size=settings.width,
        handles=methods((series for each in found for series in each.series.values()), looks),
        notes=[
            f"Points: mean over the evaluation steps of the interquartile mean over seeds ({settings.kind}), with its "
            f"{SURE} bootstrap interval. Small and hollow: the interquartile mean at the last step.",
            *([f"{ALL_TASKS}: mean over the tasks, each resampled on its own."] if means else []),
            *(f"Not drawn: {why}." for why in apart),
            *contents(section),
        ],
        most=4,
    )


def _read(section: Section) -> tuple[dict[Series, Floats], list[str]]:
    """What is read of each series that asks, at the steps that all such of its task have; and why some are not."""
    values: dict[Series, Floats] = {}
    apart = []
    asking = [each for each in section.series if each.n and each.label.feedback != NOTHING_ASKED]
    for task in dict.fromkeys(each.label.task for each in asking):
        try:
            values |= read_together([each for each in asking if each.label.task == task])[1]
        except UserError as error:
            apart.append(str(error))
    return values, apart


def sweeps(section: Section) -> list[Sweep]:
    """The comparisons of schedules that the section holds, task by task."""
    asked: dict[tuple[str, str], dict[tuple[str, Schedule], Series]] = {}
    for series in _read(section)[0]:
        schedule = Schedule.of(series.label.feedback)
        if schedule and not schedule.name:
            asked.setdefault((series.label.task, series.label.teacher), {})[series.label.method, schedule] = series
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


def _means(found: Sequence[Sweep]) -> list[list[Sweep]]:
    """Sweeps of several success tasks over the same schedules under the same teacher."""
    groups: dict[Any, list[Sweep]] = {}
    for each in found:
        if all(series.score == "success" for series in each.series.values()):
            groups.setdefault((each.field, each.teacher, each.schedules), []).append(each)
    return [group for group in groups.values() if len(group) > 1]


def _cell(
    group: Sequence[Sweep], found: Sequence[Sweep], values: Mapping[Series, Floats], looks: Looks, settings: Statistics
) -> Slot:
    """A panel: one task, or the mean of several."""
    first = group[0]
    name = first.task if len(group) == 1 else ALL_TASKS
    teachers = {each.teacher for each in found}
    if len(teachers) > 1:
        name += f", teacher {first.teacher}"
    unit = next(iter(first.series.values())).score
    if first.field == "batch":
        across = f"Queries a session,\nevery {told(first.schedules[0].every)} steps"
    else:
        across = f"Steps between\nsessions of {first.schedules[0].batch}"
    return Slot(name, UNITS[unit], _filler(group, unit, values, looks, settings), across)


def _filler(
    group: Sequence[Sweep], unit: str, values: Mapping[Series, Floats], looks: Looks, settings: Statistics
) -> Callable[[Axes], None]:
    first, scale = group[0], 100 if unit == "success" else 1
    names = list(dict.fromkeys(method for method, _ in first.series))

    def fill(axes: Axes) -> None:
        for row, method in enumerate(names):
            shift = 0.12 * (row - (len(names) - 1) / 2)
            have = [at for at, each in enumerate(first.schedules) if all((method, each) in s.series for s in group)]
            read = [[values[sweep.series[method, first.schedules[at]]] for sweep in group] for at in have]
            made = [_point(tasks, settings) for tasks in read]
            _draw_points(axes, np.array(have) + shift, made, scale, looks[method])
        axes.set_xticks(range(len(first.schedules)), [told(getattr(each, first.field)) for each in first.schedules])
        axes.set_xlim(-0.4, len(first.schedules) - 0.6)
        score_axis(axes, unit)

    return fill


def _point(tasks: Sequence[Floats], settings: Statistics) -> tuple[Estimate, float]:
    """Of one method under one schedule on each task: the mean over the steps, and the value at the last of them."""
    last = [iqm(values[:, -1], settings.kind) for values in tasks]
    return score(tasks, settings).estimate(), float(np.mean(last))


def _draw_points(axes: Axes, x: Floats, made: Sequence[tuple[Estimate, float]], scale: float, look: Style) -> None:
    """Means with their intervals on a line, and the last steps' values, small and hollow, on none."""
    means, last = [each for each, _ in made], [scale * final for _, final in made]
    y, low, high = (scale * np.array([float(getattr(e, part)) for e in means]) for part in ("estimate", "low", "high"))
    axes.plot(x, y, linewidth=1.3, markersize=4, markeredgewidth=0.8, **look._asdict())
    axes.vlines(x, low, high, color=look.color, linewidth=0.9)
    hollow = look._asdict() | {"linestyle": "none", "markerfacecolor": "white"}
    axes.plot(x, last, markersize=3, markeredgewidth=0.6, **hollow)


less_feedback = FromFrames(draw)
