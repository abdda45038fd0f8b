"""Little feedback: a number for each budget and method, the mean over the evaluations of the IQM (Fig. less).

Every schedule of feedback is a row, every method a column. The mean
goes over the steps that all runs of a task have in common. The first
rows are the mean over all tasks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.labels import NOTHING_ASKED
from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.report import NOTHING, Grid, Report, counts, highest, interval, number, some
from rrmctl.reports.scores import read_together, score
from rrmctl.reports.series import Section, Series
from rrmctl.reports.statistics import DEFAULTS, Statistics

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.reports.series import Floats, Steps

EXPERIMENT = "less-feedback"

#: Stands for the task in the rows of the mean over all of them.
ALL_TASKS = "all tasks"

EXPLAINED = (
    "Feedback: questions of a session @ steps between sessions / questions in all.",
    "Numbers: mean of the IQM over the evaluations that all runs of a task have.",
    f'"{ALL_TASKS}": mean over the tasks; each is resampled on its own. n adds up the runs of all.',
    "n holds for every method of a row, or for one after the other where they differ.",
)

COLUMNS = (
    "task", "teacher", "feedback", "method", "score", "first_step", "last_step", "evaluations", "mean_iqm", "low",
    "high", "n", "planned",
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section in which a task is asked about by several schedules.

    Raises:
        NoDataError: there is none.
    """
    made = [_report(section, settings) for section in sections if _schedules(section)]
    lacking = "no task has runs under several schedules of feedback"
    return some(made, sections, lacking, "`rrmctl run less-feedback` makes them")


def table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """One row per task (all tasks first), schedule and method: columns `COLUMNS`, success as a fraction."""
    import pandas as pd

    schedules = _schedules(section)
    rows = [row for task, by_schedule in schedules.items() for row in _task_rows(task, by_schedule, settings)]
    return pd.DataFrame([*_all_tasks(schedules, settings), *rows], columns=list(COLUMNS))


#: By teacher and feedback, the series of each method.
Schedules = Mapping[tuple[str, str], Mapping[str, Series]]


def _schedules(section: Section) -> dict[str, Schedules]:
    """For each task with several schedules of feedback, what was run."""
    found: dict[str, dict[tuple[str, str], dict[str, Series]]] = {}
    for panel in section.panels():
        asked = {each.label.method: each for each in panel.series if each.label.feedback != NOTHING_ASKED}
        found.setdefault(panel.task, {})[panel.teacher, panel.feedback] = asked
    return {task: schedules for task, schedules in found.items() if len(schedules) > 1}


def _read(schedules: Schedules) -> tuple[Steps, dict[Series, Floats]]:
    """A task's series at the steps that all of them have."""
    return read_together([each for methods in schedules.values() for each in methods.values() if each.n])


def _task_rows(task: str, schedules: Schedules, settings: Statistics) -> Iterator[dict[str, Any]]:
    steps, read = _read(schedules)
    for (teacher, feedback), methods in schedules.items():
        for method, series in methods.items():
            yield {
                "task": task, "teacher": teacher, "feedback": feedback, "method": method, "score": series.score,
                "first_step": int(steps[0]), "last_step": int(steps[-1]), "evaluations": int(steps.size),
                "n": series.n, "planned": series.planned,
                **(_numbers([read[series]], settings) if series.n else {}),
            }  # fmt: skip


def _all_tasks(tasks: Mapping[str, Schedules], settings: Statistics) -> Iterator[dict[str, Any]]:
    """The mean over the tasks, where there are several, all read by success, and a method has runs on each."""
    series = [each for by in tasks.values() for methods in by.values() for each in methods.values()]
    if len(tasks) < 2 or {each.score for each in series} != {"success"}:
        return
    read = {each: values for schedules in tasks.values() for each, values in _read(schedules)[1].items()}
    by_key = [
        {(*asked, method): each for asked, methods in schedules.items() for method, each in methods.items() if each.n}
        for schedules in tasks.values()
    ]
    for key in (key for key in by_key[0] if all(key in each for each in by_key)):
        teacher, feedback, method = key
        here = [each[key] for each in by_key]
        yield {
            "task": ALL_TASKS, "teacher": teacher, "feedback": feedback, "method": method, "score": "success",
            "n": sum(each.n for each in here), "planned": sum(each.planned for each in here),
            **_numbers([read[each] for each in here], settings),
        }  # fmt: skip


def _numbers(tasks: Sequence[Floats], settings: Statistics) -> dict[str, float]:
    found = score(tasks, settings).estimate()
    return {"mean_iqm": float(found.estimate), "low": float(found.low), "high": float(found.high)}


def _report(section: Section, settings: Statistics) -> Report:
    found = table(section, settings).astype({"evaluations": "Int64", "first_step": "Int64", "last_step": "Int64"})
    grid = _grid(found)
    return Report(title(section), found, grid, tuple(_notes(section, found, settings)), facts(section, settings))


def _grid(found: pd.DataFrame) -> Grid:
    """A row for each task and schedule, and a column for each method."""
    names = ["task", "teacher", "feedback"] if found["teacher"].nunique() > 1 else ["task", "feedback"]
    by_key = {(tuple(row[name] for name in names), row["method"]): row for row in found.to_dict("records")}
    keys = list(dict.fromkeys(key for key, _ in by_key))
    columns: dict[str, Sequence[str]] = {name.capitalize(): [key[at] for key in keys] for at, name in enumerate(names)}
    for method in dict.fromkeys(found["method"]):
        columns[method] = [_cell(by_key.get((key, method))) for key in keys]
    columns["n"] = [counts(row for (other, _), row in by_key.items() if other == key) for key in keys]
    at = {name: column for column, name in enumerate(columns)}
    entries = (((keys.index(key), at[name]), key, row["mean_iqm"]) for (key, name), row in by_key.items())
    return Grid.of(columns, words=len(names), best=highest(entries))


def _cell(row: dict[Any, Any] | None) -> str:
    if row is None or math.isnan(row["mean_iqm"]):
        return NOTHING
    return f"{number(row['mean_iqm'], row['score'])} {interval(row['low'], row['high'], row['score'], row['n'])}"


def _notes(section: Section, found: pd.DataFrame, settings: Statistics) -> Iterator[str]:
    yield from contents_notes(section)
    own = found[found["task"] != ALL_TASKS].drop_duplicates("task")
    for row in own.to_dict("records"):
        yield (
            f"{row['task']}: {row['evaluations']} evaluations, from step {row['first_step']:,} to {row['last_step']:,}."
        )
    yield from statistics_notes(section, settings)
