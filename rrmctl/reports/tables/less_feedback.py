"""Little feedback: a number for each budget and method, the mean over the evaluations of the IQM (Fig. less).

Every schedule of feedback is a row, every method a column. The mean
goes over the steps that all runs of a task have in common. The first
rows are the mean over all tasks.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rrmctl.labels import NOTHING_ASKED
from rrmctl.reports.columns import COMPARED, METHOD, RUNS, SCORE, interval, number, pivoted
from rrmctl.reports.report import NOTHING, Column, Grid, Report, Row, report, some
from rrmctl.reports.scores import read_together, score
from rrmctl.reports.series import Section, Series
from rrmctl.reports.statistics import Statistics
from rrmctl.stats import Floats
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT

EXPERIMENT = "less-feedback"

#: Stands for the task in the rows of the mean over all of them.
EVERY_TASK = "all tasks"

EXPLAINED = (
    "Feedback: questions of a session @ steps between sessions / questions in all.",
    "Numbers: mean of the IQM over the evaluations that all runs of a task have.",
    f'"{EVERY_TASK}": mean over the tasks; each is resampled on its own. n adds up the runs of all.',
    "n holds for every method of a row, or for one after the other where they differ.",
)

PLACE = (
    Column("task", TEXT, "Task"),
    Column("teacher", TEXT, "Teacher", apart=()),
    Column("feedback", TEXT, "Feedback"),
)
COLUMNS = (
    *PLACE, METHOD, SCORE,
    *(Column(name, MAYBE_WHOLE) for name in ("first_step", "last_step", "evaluations")),
    *(Column(name, NUMBER) for name in ("mean_iqm", "low", "high")), *RUNS,
)  # fmt: skip

#: By teacher and feedback, the series of each method.
Schedules = Mapping[tuple[str, str], Mapping[str, Series]]


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section in which a task is asked by several schedules."""
    made = []
    for section in sections:
        if schedules := _schedules(section):
            rows = _rows(schedules, settings)
            made.append(report(section, settings, COLUMNS, rows, grid=_grid, notes=_notes(rows)))
    lacking = "no task has runs under several schedules of feedback"
    return some(made, sections, lacking, "`rrmctl run less-feedback` makes them")


def _schedules(section: Section) -> dict[str, Schedules]:
    """For each task with several schedules of feedback, what was run."""
    found: dict[str, dict[tuple[str, str], dict[str, Series]]] = {}
    for panel in section.panels():
        asked = {each.label.method: each for each in panel.series if each.label.feedback != NOTHING_ASKED}
        found.setdefault(panel.task, {})[panel.teacher, panel.feedback] = asked
    return {task: schedules for task, schedules in found.items() if len(schedules) > 1}


def _rows(tasks: Mapping[str, Schedules], settings: Statistics) -> list[dict[str, Any]]:
    """A row for each task, schedule and method, success as a fraction; before them those of all tasks together.

    These are where there are several tasks, all read by success, of each method that has runs on all of them.
    """
    rows: list[dict[str, Any]] = []
    everywhere: dict[tuple[str, ...], list[tuple[Floats, Series]]] = defaultdict(list)
    for task, schedules in tasks.items():
        steps, read = read_together([each for methods in schedules.values() for each in methods.values() if each.n])
        span = {"first_step": int(steps[0]), "last_step": int(steps[-1]), "evaluations": int(steps.size)}
        for asked, methods in schedules.items():
            for method, series in methods.items():
                row = _named(task, *asked, method) | span
                row |= {"score": series.score, "n": series.n, "planned": series.planned}
                if series.n:
                    row |= score([read[series]], settings).row("mean_iqm")
                    everywhere[(*asked, method)].append((read[series], series))
                rows.append(row)
    together = []
    if len(tasks) > 1 and {row["score"] for row in rows} == {"success"}:
        for key, members in everywhere.items():
            if len(members) == len(tasks):
                counted = {name: sum(getattr(series, name) for _, series in members) for name in ("n", "planned")}
                mean = score([values for values, _ in members], settings).row("mean_iqm")
                together.append({**_named(EVERY_TASK, *key), "score": "success", **counted, **mean})
    return together + rows


def _named(*words: str) -> dict[str, Any]:
    return dict(zip((*COMPARED, "method"), words, strict=True))


def _grid(rows: Sequence[Row]) -> Grid:
    """A row for each task and schedule, and a column for each method."""
    return pivoted(
        rows, PLACE, lambda row: str(row["method"]), {"{}": _cell},
        best=("mean_iqm", lambda row: tuple(row[name] for name in COMPARED)),
    )  # fmt: skip


def _cell(row: Row) -> str:
    if math.isnan(row["mean_iqm"]):
        return NOTHING
    return f"{number(row['mean_iqm'], row['score'])} {interval(row['low'], row['high'], row['score'], row['n'])}"


def _notes(rows: Sequence[Row]) -> Iterator[str]:
    for row in {row["task"]: row for row in rows if row["task"] != EVERY_TASK}.values():
        yield (
            f"{row['task']}: {row['evaluations']} evaluations, from step {row['first_step']:,} to {row['last_step']:,}."
        )
