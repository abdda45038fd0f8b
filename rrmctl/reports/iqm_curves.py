"""The IQM table and the IQM curves of a section, as DataFrames.

Values are raw here: success as a fraction, returns as they are. What must stand beside them is added where a report is
made of them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rrmctl.reports.series import Floats, Panel, Section, Series, Steps, at_steps
from rrmctl.reports.statistics import BOOTSTRAP_SEED, DEFAULTS, LEVEL, Statistics
from rrmctl.stats import (
    Estimate,
    Iqm,
    area_under_curve,
    bootstrap,
    estimate,
    interval_possible,
    iqm,
    quartiles,
    resample,
)
from rrmctl.store.frame import MAYBE_WHOLE, WHOLE, typed

if TYPE_CHECKING:
    import pandas as pd

#: Of the curves' parquet file; raised by one when a column is added, removed, or changes its meaning.
CURVES_VERSION = 1
COLUMNS = (
    "task", "teacher", "feedback", "method", "score", "step", "step_rule", "iqm", "low", "high", "q25", "q75", "n",
    "planned", "auc", "auc_low", "auc_high",
)  # fmt: skip
CURVE_COLUMNS = (
    "experiment", "variant", "profile", "task", "method", "teacher", "feedback", "step", "iqm", "q25", "q75", "low",
    "high", "n", "iqm_kind", "schema_version",
)  # fmt: skip

#: Stands for the task in rows that pool all tasks read by success.
ALL_TASKS = "success tasks"


@dataclass(frozen=True, eq=False)
class Curve:
    """A series' statistics at each of its steps."""

    series: Series
    iqm: Estimate  #: arrays [T]
    q25: Floats  #: [T]
    q75: Floats  #: [T]
    #: Under the IQM curve, as mean heights over the steps of each panel it stands in, by teacher and feedback.
    areas: Mapping[tuple[str, str], Estimate]


@lru_cache(maxsize=64)  # a table and the file beside it are made of the same curves; replicates are not kept
def curves(section: Section, settings: Statistics = DEFAULTS) -> Mapping[Series, Curve]:
    """The curve of every series that has a run."""
    panels = [panel for panel in section.panels() if panel.comparable()]
    own = {each: [panel for panel in panels if each in panel.series] for each in section.series if each.n}
    return {each: _curve(each, where, settings) for each, where in own.items()}


def _curve(series: Series, panels: Sequence[Panel], settings: Statistics) -> Curve:
    draws = None
    if interval_possible([series.n]):
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        draws = resample([series.values], Iqm(settings.kind), rng=rng, replicates=settings.replicates)
    q25, q75 = quartiles(series.values, axis=0)
    point = iqm(series.values, settings.kind, axis=0)
    areas = {(panel.teacher, panel.feedback): _area(series, panel.steps(), point, draws) for panel in panels}
    return Curve(series, estimate(point, draws, n=series.n, level=LEVEL), q25, q75, areas)


def _area(series: Series, steps: Steps, point: Floats, draws: Floats | None) -> Estimate:
    """Under a curve [T] with its replicates [R, T], over these of its steps."""
    where = np.searchsorted(series.steps, steps)
    drawn = None if draws is None else area_under_curve(steps, draws[:, where])
    return estimate(area_under_curve(steps, point[where]), drawn, n=series.n, level=LEVEL)


def curve_table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """The IQM curves of a section, one row per series and step: columns `CURVE_COLUMNS`."""
    import pandas as pd

    rows = [
        (section.experiment, section.variant, section.profile, *series.label, int(step), *map(float, numbers), series.n)
        for series, curve in curves(section, settings).items()
        for step, *numbers in zip(
            series.steps, curve.iqm.estimate, curve.q25, curve.q75, curve.iqm.low, curve.iqm.high, strict=True
        )
    ]
    table = pd.DataFrame(rows, columns=list(CURVE_COLUMNS[:-2]))
    return typed(table.assign(iqm_kind=settings.kind, schema_version=CURVES_VERSION))


def iqm_table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """Per task and method the IQM at the task's common step, with its interval: columns `COLUMNS`."""
    import pandas as pd

    panels, made = section.panels(), curves(section, settings)
    rows = [row for panel in panels for row in _panel_rows(panel, made)]
    rows += [row for group in across_tasks(panels) for row in _group_rows(group, settings)]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    return typed(table, {"step": MAYBE_WHOLE, "n": WHOLE, "planned": WHOLE})


def _panel_rows(panel: Panel, made: Mapping[Series, Curve]) -> Iterator[dict[str, Any]]:
    read = panel.read_at()
    rule = "final" if panel.score == "return" else "first" if read.reached else "last"
    for series in panel.series:
        row: dict[str, Any] = {
            "task": panel.task, "teacher": panel.teacher, "feedback": panel.feedback, "method": series.label.method,
            "score": panel.score, "step": read.step, "step_rule": rule, "n": series.n, "planned": series.planned,
        }  # fmt: skip
        if series in made:
            curve = made[series]
            at, area = int(np.searchsorted(series.steps, read.step)), curve.areas[panel.teacher, panel.feedback]
            row |= {"iqm": curve.iqm.estimate[at], "low": curve.iqm.low[at], "high": curve.iqm.high[at]}
            row |= {"q25": curve.q25[at], "q75": curve.q75[at]}
            row |= {"auc": area.estimate, "auc_low": area.low, "auc_high": area.high}
        yield {key: float(value) if isinstance(value, np.ndarray) else value for key, value in row.items()}


def across_tasks(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Panels of different success tasks that may be pooled: as many tasks in each group as there are, or no group."""
    success = [panel for panel in panels if panel.score == "success"]
    tasks = {panel.task for panel in success}
    if len(tasks) < 2:
        return []
    if len(success) == len(tasks):
        return [success]  # one teacher and schedule for each task, though a schedule may be the task's own
    groups: dict[tuple[str, str], list[Panel]] = defaultdict(list)
    for panel in success:
        groups[panel.teacher, panel.feedback].append(panel)
    return [group for group in groups.values() if len(group) == len(tasks)]


def _group_rows(group: Sequence[Panel], settings: Statistics) -> Iterator[dict[str, Any]]:
    """A row for every method that has runs on all tasks of the group, each task read at its own common step."""
    by_task = [{series.label.method: series for series in panel.present()} for panel in group]
    teachers, schedules = {panel.teacher for panel in group}, {panel.feedback for panel in group}
    for method in (name for name in by_task[0] if all(name in found for found in by_task)):
        series = [found[method] for found in by_task]
        scores = [
            at_steps(each, np.array([panel.read_at().step]))[:, 0] for each, panel in zip(series, group, strict=True)
        ]
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        found = bootstrap(scores, Iqm(settings.kind), rng=rng, replicates=settings.replicates, level=LEVEL)
        q25, q75 = quartiles(np.concatenate(scores))
        yield {
            "task": ALL_TASKS, "teacher": _only(teachers, "several"), "method": method,
            "feedback": _only(schedules, "each task's"), "score": "success",
            "step": None, "step_rule": "each", "iqm": float(found.estimate), "low": float(found.low),
            "high": float(found.high), "q25": float(q25), "q75": float(q75), "n": found.n,
            "planned": sum(each.planned for each in series),
        }  # fmt: skip


def _only(names: set[str], otherwise: str) -> str:
    return next(iter(names)) if len(names) == 1 else otherwise
