"""Teachers who err: final success under each, beside the paper's (Tab. wrongiqm1).

Interquartile mean at the last step that all methods under a teacher have
in common: where the runs under the stochastic teacher are shorter, the
oracle is read there too. --plus-minus gives the paper's form, a column
for each teacher.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from rrmctl.labels import NOTHING_ASKED, ORACLE
from rrmctl.reports import published
from rrmctl.reports.columns import (
    METHOD,
    NOTHING,
    RUNS,
    SCORE,
    STEP,
    Column,
    Row,
    TextGrid,
    estimated,
    pivoted,
    plus_minus,
)
from rrmctl.reports.report import Report, section_report, some
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables.final import final_rows
from rrmctl.store.frame import NUMBER, TEXT

EXPERIMENTS = ("noisy-teacher",)
OPTIONS = ("plus_minus",)

#: What the paper calls a learner without a prior, and which those are.
_BASELINE = "baseline"
_BASELINES = ("pebble", "surf", "mrn")

EXPLAINED = (
    "Paper: in % ± half a 95 % interval. Difference: ours less the paper's, in percentage points.",
    "With --plus-minus, ± is half the width of the interval, which need not lie evenly about the value, nor end at "
    f"100 %; {_BASELINE} is the learner without a prior, which residual models build on.",
    "Mistaken teachers are asked with two budgets. The paper's table does not say which is its own; for MRN on "
    "Button-press the paper names 100 queries, and its baselines' 16 and 2.3 % look like those.",
)
_RESIDUAL = re.compile(r"rrm-(?:surf-|mrn-)?(.+)")


def _paper(row: Row) -> str:
    return plus_minus(row["published"], row["published_half"], row["score"])


_TASK, _TEACHER = Column("task", TEXT, "Task", apart=()), Column("teacher", TEXT, "Teacher")
_FEEDBACK = Column("feedback", TEXT, "Feedback", apart=("task", "teacher"))
COLUMNS = (
    _TASK, _TEACHER, _FEEDBACK, METHOD, SCORE, STEP, *estimated("iqm", "Final", best=True), *RUNS,
    Column("published", NUMBER, "Paper", _paper), Column("published_half", NUMBER),
    Column(
        "difference", NUMBER, "Difference",
        lambda row: NOTHING if math.isnan(row["difference"]) else f"{100 * row['difference']:+.1f}",
    ),
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs under a teacher who errs."""
    reports, grid = [], _matrix if settings.plus_minus else None
    for section in sections:
        if rows := _rows(section, settings):
            steps = {_place(row, (_TASK, _TEACHER, _FEEDBACK), rows): row["step"] for row in rows}
            notes = [
                f"Read at the last common step: {', '.join(f'{name} at {step:,}' for name, step in steps.items())}.",
                f"Paper: {published.source(*EXPERIMENTS)}, at the paper's scale; ours is profile {section.profile}.",
            ]
            reports.append(section_report(section, settings, COLUMNS, rows, grid=grid, notes=notes))
    hint = "`rrmctl run noisy-teacher` makes them; `rrmctl report final` is the table for other experiments"
    return some(reports, sections, "there are no runs under a teacher who errs", hint)


def _rows(section: Section, settings: Statistics) -> list[dict[str, Any]]:
    """A row for each teacher who errs and method; success and differences as fractions."""
    panels = [panel for panel in section.panels() if panel.teacher not in (ORACLE, NOTHING_ASKED)]
    rows = [row for panel in panels for row in final_rows(panel, settings)]
    for row in rows:
        success, half = published.final(row["task"], row["teacher"], row["method"])
        difference = row.get("iqm", math.nan) - success
        row |= {"published": success, "published_half": half, "difference": difference}
    return rows


def _matrix(rows: Sequence[Row]) -> TextGrid:
    """The paper's form: a row for each method whatever it builds on, a column for each teacher, the paper's beside.

    Methods of which several would share a row keep rows of their own, and schedules of one teacher have rows each.
    """
    families = {(row["task"], row["teacher"], row["feedback"], _family(row["method"])) for row in rows}
    named = _family if len(families) == len(rows) else str
    method = Column("method", TEXT, "Method", lambda row: named(row["method"]))
    cells = {
        "{}": lambda row: plus_minus(row["iqm"], (row["high"] - row["low"]) / 2, row["score"]),
        "paper": _paper,
    }
    return pivoted(rows, (_TASK, _FEEDBACK, method), _TEACHER.text, cells, best="iqm")


def _place(row: Row, columns: Sequence[Column], rows: Sequence[Row]) -> str:
    """What tells a row from others, in words."""
    return " ".join(column.text(row) for column in columns if column.tells(rows))


def _family(method: str) -> str:
    """The method without the learner it builds on, as the paper's rows are named."""
    if method in _BASELINES:
        return _BASELINE
    residual = _RESIDUAL.fullmatch(method)
    return f"rrm-{residual[1]}" if residual else method
