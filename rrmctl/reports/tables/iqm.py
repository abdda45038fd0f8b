"""Interquartile mean of each method, with 95 % bootstrap intervals over seeds.

Success is read at the first step at which 80 % of the seeds of any
method but the oracle are at 100 %, else at the last step; returns at
the last step. Profiles and overrides never share a table. `run` and
`resume` leave the whole curves in aggregates/NAME.parquet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.iqm_curves import ALL_TASKS, iqm_table
from rrmctl.reports.report import (
    INTERVAL,
    NOTHING,
    Grid,
    Report,
    best_methods,
    interval,
    number,
    place_columns,
    spread,
)
from rrmctl.reports.series import Panel, Section
from rrmctl.reports.statistics import Statistics
from rrmctl.stats.curves import SHARE

if TYPE_CHECKING:
    import pandas as pd

EXPERIMENT = None
EXPLAINED = (
    f"Step: where the methods of a task are compared. Success: the first evaluation at which {100 * SHARE:g} % of the "
    "seeds of a method but the oracle are at 100 %, which flatters all methods alike. Where there is none (marked *), "
    "and for returns: the last one that all have.",
    "AUC: area under the IQM curve over the steps common to a task's methods, divided by their span.",
    f'"{ALL_TASKS}": the seeds of all tasks that are read by success, pooled, each task at its own step.',
)

#: Beside a step that is merely the last one, and before the note that says so.
LAST_MARK = "*"


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    return [_report(section, settings) for section in sections]


def _report(section: Section, settings: Statistics) -> Report:
    table = iqm_table(section, settings)
    return Report(title(section), table, _grid(table), tuple(_notes(section, settings)), facts(section, settings))


def _grid(table: pd.DataFrame) -> Grid:
    """The table for people; columns that say nothing are left out."""
    columns = place_columns(table) | {"Method": list(table["method"])}
    words, rows = len(columns), table.to_dict("records")
    columns["Step"] = [_step(row) for row in rows]
    columns["IQM"] = [number(row["iqm"], row["score"]) for row in rows]
    columns[INTERVAL] = [interval(row["low"], row["high"], row["score"], row["n"]) for row in rows]
    columns["25-75 %"] = [spread(row["q25"], row["q75"], row["score"], "{}..{}") for row in rows]
    columns["n"] = [f"{row['n']}/{row['planned']}" for row in rows]
    columns["AUC"] = [number(row["auc"], row["score"]) for row in rows]
    best = best_methods(table, "iqm", ("task", "teacher", "feedback"), list(columns).index("IQM"))
    return Grid.of(columns, words=words, best=best)


def _step(row: dict[Any, Any]) -> str:
    if row["step_rule"] == "each":
        return NOTHING
    return f"{row['step']:,}" + (LAST_MARK if row["step_rule"] == "last" else "")


def _notes(section: Section, settings: Statistics) -> Iterator[str]:
    yield from contents_notes(section)
    yield from _step_notes(section.panels())
    yield from statistics_notes(section, settings)


def _step_notes(panels: Sequence[Panel]) -> Iterator[str]:
    """Who chose the step of each panel, and what the mark beside the others means."""
    share = f"{100 * SHARE:g} %"
    merely_last = False
    for panel in panels:
        alone = sum(each.task == panel.task for each in panels) == 1
        name = panel.task if alone else f"{panel.task} ({panel.teacher}, {panel.feedback})"
        read = panel.read_at()
        if read.reached:
            yield f"{name} is read where {share} of the seeds of {' and '.join(read.by)} are at 100 % first."
        merely_last |= not read.reached and panel.score == "success"
    if merely_last:
        yield f"{LAST_MARK} the last common step: no method but the oracle ever has {share} of its seeds at 100 %."
