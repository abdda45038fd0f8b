"""Less feedback: success against the size of a session, and against the steps between two, a point for each budget.

A point is the mean over the evaluation steps of the interquartile mean over seeds, with its bootstrap interval; the
small hollow one above or below it is the interquartile mean at the last step. Of several tasks it is their mean.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from rrmctl.errors import UserError
from rrmctl.labels import NOTHING_ASKED, Schedule
from rrmctl.reports.figure_layout import Axes, Figure, Slot, from_frames, sheet
from rrmctl.reports.iqm_curves import ALL_TASKS
from rrmctl.reports.plot_elements import UNITS, score_axis, short_steps
from rrmctl.reports.report import final_notes
from rrmctl.reports.scores import common_steps, score
from rrmctl.reports.series import Section, Series, at_steps
from rrmctl.reports.statistics import DEFAULTS, SURE, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import Floats, Steps, iqm


@dataclass(frozen=True, eq=False)
class Sweep:
    """The schedules of one task and teacher that differ in one respect."""

    task: str
    teacher: str
    score: str
    field: str  #: of `Schedule`, in which they differ
    schedules: tuple[Schedule, ...]  #: from most feedback to least
    steps: Steps  #: those that all of the task have
    series: Mapping[tuple[str, Schedule], Series]  #: by method


def suits(section: Section) -> bool:
    """Some task is asked under schedules that differ in one respect alone."""
    return bool(_sweeps(section)[0])


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """For each task, and for the mean of the success tasks, a panel for each respect in which schedules differ."""
    (sweeps, apart), looks = _sweeps(section), section.looks()
    groups = defaultdict[Any, list[Sweep]](list)  # over the same schedules under the same teacher
    for sweep in sweeps:
        if sweep.score == "success":
            groups[sweep.field, sweep.teacher, sweep.schedules].append(sweep)
    means = [group for group in groups.values() if len(group) > 1]
    several = len({sweep.teacher for sweep in sweeps}) > 1
    return sheet(
        section,
        settings,
        [_slot(group, several, looks, settings) for group in [*([sweep] for sweep in sweeps), *means]],
        notes=[
            f"Points: mean over the evaluation steps of the interquartile mean over seeds ({settings.kind}), with its "
            f"{SURE} bootstrap interval. Small and hollow: the interquartile mean at the last step.",
            *([f"{ALL_TASKS}: mean over the tasks, each resampled on its own."] if means else []),
            *final_notes(section, settings, [(sweep.task, int(sweep.steps[-1])) for sweep in sweeps]),
            *(f"Not drawn: {why}." for why in apart),
        ],
        lacking="no schedules of feedback that could be compared",
        most=4,
    )


def _sweeps(section: Section) -> tuple[list[Sweep], list[str]]:
    """The comparisons of schedules that the section holds, task by task, and why some tasks have none."""
    sweeps, apart = [], []
    tasks = defaultdict[str, list[Series]](list)
    for series in section.series:
        if series.n and series.label.feedback != NOTHING_ASKED:
            tasks[series.label.task].append(series)
    for task, asking in tasks.items():
        try:
            steps = common_steps(asking)
        except UserError as error:
            apart.append(str(error))
            continue
        taught = defaultdict[str, dict[tuple[str, Schedule], Series]](dict)
        for series in asking:
            schedule = Schedule.of(series.label.feedback)
            if schedule and not schedule.name:
                taught[series.label.teacher][series.label.method, schedule] = series
        for teacher, points in taught.items():
            for field, chosen in _compared({schedule for _, schedule in points}):
                own = {key: series for key, series in points.items() if key[1] in chosen}
                sweeps.append(Sweep(task, teacher, asking[0].score, field, chosen, steps, own))
    return sweeps, apart


def _compared(schedules: set[Schedule]) -> Iterator[tuple[str, tuple[Schedule, ...]]]:
    """By the size of a session those of the shortest wait, and by the wait those of the largest session."""
    batch, every = max(schedule.batch for schedule in schedules), min(schedule.every for schedule in schedules)
    sizes = sorted((schedule for schedule in schedules if schedule.every == every), reverse=True)
    waits = sorted((schedule for schedule in schedules if schedule.batch == batch), key=attrgetter("every"))
    for field, chosen in (("batch", sizes), ("every", waits)):
        if len({getattr(schedule, field) for schedule in chosen}) == len(chosen) > 1:
            yield field, tuple(chosen)


def _slot(group: Sequence[Sweep], several: bool, looks: Looks, settings: Statistics) -> Slot:
    """A panel: one task, or the mean of several; `several` teachers are named."""
    first, schedules, scale = group[0], group[0].schedules, 100 if group[0].score == "success" else 1
    methods = list(dict.fromkeys(method for method, _ in first.series))

    def read(steps: slice, method: str, schedule: Schedule, last: int = 1) -> list[Floats]:
        return [at_steps(sweep.series[method, schedule], sweep.steps[steps], last) for sweep in group]

    def fill(axes: Axes) -> None:
        for row, method in enumerate(methods):
            held = [schedule for schedule in schedules if all((method, schedule) in sweep.series for sweep in group)]
            x = np.array(list(map(schedules.index, held))) + 0.12 * (row - (len(methods) - 1) / 2)
            means = [score(read(slice(None), method, schedule), settings).estimate() for schedule in held]
            y, low, high = (
                [scale * float(getattr(mean, end)) for mean in means] for end in ("estimate", "low", "high")
            )
            finals = [read(slice(-1, None), method, schedule, settings.last) for schedule in held]
            last = [scale * np.mean([iqm(task[:, 0], settings.kind) for task in tasks]) for tasks in finals]
            look: dict[str, Any] = looks[method]._asdict()
            axes.plot(x, y, **look | {"markersize": 4})
            axes.vlines(x, low, high, color=looks[method].color, linewidth=0.9)
            hollow = {"linestyle": "none", "markerfacecolor": "white", "markersize": 3, "markeredgewidth": 0.6}
            axes.plot(x, last, **look | hollow)
        ticks = [short_steps(getattr(schedule, first.field)) for schedule in schedules]
        axes.set_xticks(range(len(ticks)), ticks)
        axes.set_xlim(-0.4, len(schedules) - 0.6)
        score_axis(axes, first.score)

    name = (first.task if len(group) == 1 else ALL_TASKS) + (f", teacher {first.teacher}" if several else "")
    if first.field == "batch":
        across = f"Queries a session,\nevery {short_steps(schedules[0].every)} steps"
    else:
        across = f"Steps between\nsessions of {schedules[0].batch}"
    runs = [(method, series.n) for sweep in group for (method, _), series in sweep.series.items()]
    return Slot(name, UNITS[first.score], fill, across, runs)


less_feedback = from_frames(draw)
