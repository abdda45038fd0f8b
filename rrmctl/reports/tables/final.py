"""Scores at the last step: interquartile mean of each method with its 95 % interval.

Success, or true return where the task is read by that, at the last step
that all methods of a comparison have in common. The best method but the
oracle is in bold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.report import INTERVAL, Grid, Report, best_methods, interval, number, place_columns, spread
from rrmctl.reports.scores import at, score
from rrmctl.reports.series import Panel, Section
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.stats import quartiles

if TYPE_CHECKING:
    import pandas as pd

EXPERIMENT = None
EXPLAINED = ("Step: the last evaluation that all methods of a task have.",)

COLUMNS = (
    "task", "teacher", "feedback", "method", "score", "step", "iqm", "low", "high", "q25", "q75", "n", "planned",
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    return [_report(section, settings) for section in sections]


def table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """One row per comparison and method: columns `COLUMNS`, success as a fraction."""
    import pandas as pd

    return pd.DataFrame(
        [row for panel in section.panels() for row in final_rows(panel, settings)], columns=list(COLUMNS)
    )


def final_rows(panel: Panel, settings: Statistics) -> Iterator[dict[str, Any]]:
    """The rows of one comparison."""
    step = int(panel.steps()[-1])
    for series in panel.series:
        row: dict[str, Any] = {
            "task": panel.task, "teacher": panel.teacher, "feedback": panel.feedback, "method": series.label.method,
            "score": panel.score, "step": step, "n": series.n, "planned": series.planned,
        }  # fmt: skip
        if series.n:
            values = at(series, step)
            found = score([values], settings).estimate()
            row |= {"iqm": float(found.estimate), "low": float(found.low), "high": float(found.high)}
            row |= dict(zip(("q25", "q75"), map(float, quartiles(values)), strict=True))
        yield row


def _report(section: Section, settings: Statistics) -> Report:
    found = table(section, settings)
    rows = found.to_dict("records")
    columns = place_columns(found) | {"Method": list(found["method"])}
    words = len(columns)
    columns["Step"] = [f"{row['step']:,}" for row in rows]
    columns["Final"] = [number(row["iqm"], row["score"]) for row in rows]
    columns[INTERVAL] = [interval(row["low"], row["high"], row["score"], row["n"]) for row in rows]
    columns["25-75 %"] = [spread(row["q25"], row["q75"], row["score"], "{}..{}") for row in rows]
    columns["n"] = [f"{row['n']}/{row['planned']}" for row in rows]
    best = best_methods(found, "iqm", ("task", "teacher", "feedback"), list(columns).index("Final"))
    notes = (*contents_notes(section), *statistics_notes(section, settings))
    grid = Grid.of(columns, words=words, best=best)
    return Report(title(section), found, grid, notes, facts(section, settings))
