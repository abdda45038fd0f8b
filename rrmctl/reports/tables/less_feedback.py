"""Little feedback: for each budget and method the mean over the evaluations of the IQM, and the last IQM (Fig. less).

Every schedule of feedback has a row for either, every method a column.
The mean goes over the steps that all runs of a task have in common, the
last is of the last of them. The first rows are the mean over all tasks.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rrmctl.labels import NOTHING_ASKED
from rrmctl.reports.columns import COMPARED, METHOD, RUNS, SCORE, Column, Row, TextGrid, estimated, pivoted
from rrmctl.reports.report import Report, section_report, some
from rrmctl.reports.scores import common_steps, score
from rrmctl.reports.series import Panel, Section, Series, at_steps
from rrmctl.reports.statistics import Statistics
from rrmctl.stats import Steps
from rrmctl.store.frame import MAYBE_WHOLE, TEXT

EXPERIMENTS = ("less-feedback",)

#: Stands for the task in the rows of the mean over all of them.
EVERY_TASK = "all tasks"

#: What is read, by the name of its value, in words.
_READINGS = {"mean_iqm": "over steps", "final_iqm": "last step"}

EXPLAINED = (
    "Feedback: questions of a session @ steps between sessions / questions in all.",
    f"{_READINGS['mean_iqm']}: mean of the IQM over the evaluations that all runs of a task have. "
    f"{_READINGS['final_iqm']}: the IQM at the last of them, by which the paper's claims of a success rate are judged.",
    f'"{EVERY_TASK}": mean over the tasks; each is resampled on its own. n adds up the runs of all.',
    "n holds for every method of a row, or for one after the other where they differ.",
)

_PLACE = (
    Column("task", TEXT, "Task"),
    Column("teacher", TEXT, "Teacher", apart=()),
    Column("feedback", TEXT, "Feedback"),
)
_MEAN = estimated("mean_iqm", "Mean IQM")
_FINAL = estimated("final_iqm", "Last IQM", "final_")
COLUMNS = (
    *_PLACE, METHOD, SCORE,
    *(Column(name, MAYBE_WHOLE) for name in ("first_step", "last_step", "evaluations")),
    *_MEAN, *_FINAL, *RUNS,
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section in which a task is key by several schedules."""
    reports = []
    for section in sections:
        if tasks := _asking(section):
            rows = _rows(tasks, settings)
            notes = [
                f"{task}: {row['evaluations']} evaluations, from step {row['first_step']:,} to {row['last_step']:,}."
                for task, row in {row["task"]: row for row in rows if row["task"] != EVERY_TASK}.items()
            ]
            reports.append(section_report(section, settings, COLUMNS, rows, grid=_grid, notes=notes))
    lacking = "no task has runs under several schedules of feedback"
    return some(reports, sections, lacking, "`rrmctl run less-feedback` makes them")


def _asking(section: Section) -> list[list[Panel]]:
    """The panels of each task with several schedules of feedback, less what asks nothing."""
    tasks: dict[str, list[Panel]] = defaultdict(list)
    for panel in section.panels():
        asking = tuple(series for series in panel.series if series.label.feedback != NOTHING_ASKED)
        tasks[panel.task].append(replace(panel, series=asking))
    return [panels for panels in tasks.values() if len(panels) > 1]


def _rows(tasks: Sequence[Sequence[Panel]], settings: Statistics) -> list[dict[str, Any]]:
    """A row for each task, schedule and method, success as a fraction; before them those of all tasks together.

    These are where there are several tasks, all read by success, of each method that has runs on all of them.
    """
    rows: list[dict[str, Any]] = []
    everywhere: dict[tuple[str, ...], list[tuple[Steps, Series]]] = defaultdict(list)
    for panels in tasks:
        steps = common_steps([series for panel in panels for series in panel.present()])
        span = {"first_step": int(steps[0]), "last_step": int(steps[-1]), "evaluations": int(steps.size)}
        for panel in panels:
            for series in panel.series:
                rows.append(panel.row(series) | span)
                if series.n:
                    rows[-1] |= _numbers([(steps, series)], settings)
                    everywhere[panel.teacher, panel.feedback, series.label.method].append((steps, series))
    together = []
    if len(tasks) > 1 and {row["score"] for row in rows} == {"success"}:
        for key, members in everywhere.items():
            if len(members) == len(tasks):
                row = dict(zip(("teacher", "feedback", "method"), key, strict=True))
                row |= {name: sum(getattr(series, name) for _, series in members) for name in ("n", "planned")}
                together.append({"task": EVERY_TASK, "score": "success", **row, **_numbers(members, settings)})
    return together + rows


def _numbers(members: Sequence[tuple[Steps, Series]], settings: Statistics) -> dict[str, float]:
    """The mean over tasks of what is read of a series at the steps of its task: over all of them, and at the last."""
    whole = score([at_steps(series, steps) for steps, series in members], settings)
    final = score([at_steps(series, steps[-1:], settings.last) for steps, series in members], settings)
    return whole.estimate().row("mean_iqm") | final.estimate().row("final_iqm", "final_")


def _grid(rows: Sequence[Row]) -> TextGrid:
    """Two rows for each task and schedule, and a column for each method, its interval in the same cell."""
    numbers = {"mean_iqm": _MEAN, "final_iqm": _FINAL}
    read = [{**row, "read": name, "value": row[name]} for row in rows for name in numbers]
    place = (*_PLACE, Column("read", TEXT, "IQM", lambda row: _READINGS[row["read"]]))
    cells = {"{}": lambda row: " ".join(dict.fromkeys(column.text(row) for column in numbers[row["read"]][:2]))}
    compared = (*COMPARED, "read")
    return pivoted(read, place, lambda row: str(row["method"]), cells, best="value", compared=compared)
