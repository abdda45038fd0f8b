"""Teachers who err: final success under each, beside the paper's (Tab. wrongiqm1).

Interquartile mean at the last step that all methods under a teacher have
in common: where the runs under the stochastic teacher are shorter, the
oracle is read there too. --plus-minus gives the paper's form, a column
for each teacher.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rrmctl.labels import NOTHING_ASKED, ORACLE, knows
from rrmctl.reports import published
from rrmctl.reports.columns import ENDS, METHOD, RUNS, SCORE, STEP, counts, plus_minus, scored
from rrmctl.reports.report import NOTHING, Cell, Column, Grid, Report, Row, highest, report, some
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables.final import final_rows
from rrmctl.store.frame import NUMBER, TEXT

EXPERIMENT = "noisy-teacher"
OPTIONS = ("plus_minus",)

#: What the paper calls a learner without a prior, and which those are.
_BASELINE = "baseline"
_BASELINES = ("pebble", "surf", "mrn")

EXPLAINED = (
    "Paper: in % ± half a 95 % interval. Difference: ours less the paper's, in percentage points.",
    "With --plus-minus, ± is half the width of the interval, which need not lie evenly about the value, nor end at "
    f"100 %; {_BASELINE} is the learner without a prior, which residual models build on.",
)
_RESIDUAL = re.compile(r"rrm-(?:surf-|mrn-)?(.+)")


def _paper(row: Row) -> str:
    return plus_minus(row["published"], row["published_half"], row["score"])


def _signed(row: Row) -> str:
    """Between two successes, in percentage points."""
    return NOTHING if math.isnan(row["difference"]) else f"{100 * row['difference']:+.1f}"


TASK, TEACHER = Column("task", TEXT, "Task", apart=()), Column("teacher", TEXT, "Teacher")
FEEDBACK = Column("feedback", TEXT, "Feedback", apart=("task", "teacher"))
COLUMNS = (
    TASK, TEACHER, FEEDBACK, METHOD, SCORE, STEP, scored("iqm", "Final", best=True), *ENDS, *RUNS,
    Column("published", NUMBER, "Paper", _paper), Column("published_half", NUMBER),
    Column("difference", NUMBER, "Difference", _signed),
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs under a teacher who errs.

    Raises:
        NoDataError: there is none.
    """
    found = [(section, _rows(section, settings)) for section in sections]
    made = [
        report(
            section, settings, COLUMNS, rows, grid=_matrix if settings.plus_minus else None, notes=_notes(section, rows)
        )
        for section, rows in found
        if rows
    ]
    hint = "`rrmctl run noisy-teacher` makes them; `rrmctl report final` is the table for other experiments"
    return some(made, sections, "there are no runs under a teacher who errs", hint)


def _rows(section: Section, settings: Statistics) -> list[dict[str, Any]]:
    """A row for each teacher who errs and method; success and differences as fractions."""
    panels = [panel for panel in section.panels() if panel.teacher not in (ORACLE, NOTHING_ASKED)]
    rows = [row for panel in panels for row in final_rows(panel, settings)]
    for row in rows:
        known = published.final(row["task"], row["teacher"], row["method"])
        if known is not None:
            row |= {"published": known.success, "published_half": known.half}
            row["difference"] = row.get("iqm", math.nan) - known.success
    return rows


def _matrix(rows: Sequence[Row]) -> Grid:
    """The paper's form: a row for each method whatever it builds on, a column for each teacher, the paper's beside.

    Methods of which several would share a row keep rows of their own, and schedules of one teacher have columns.
    """
    keys = {(row["task"], row["teacher"], row["feedback"], _family(row["method"])) for row in rows}
    shown = _family if len(keys) == len(rows) else str
    asked = [column.name for column in (TEACHER, FEEDBACK) if column.tells(rows)]
    by_place: dict[tuple[str, str], dict[tuple[str, ...], Row]] = {}
    for row in rows:
        by_place.setdefault((row["task"], shown(row["method"])), {})[_key(row, asked)] = row
    words = 1 + TASK.tells(rows)
    header = ["Task", "Method"][-words:]
    columns = [list(column) for column in zip(*by_place, strict=True)][-words:]
    best: list[tuple[Cell, tuple[str, ...], float]] = []
    for head in dict.fromkeys(_key(row, asked) for row in rows):
        own = [by_asked.get(head) for by_asked in by_place.values()]
        best += [
            ((at, len(columns)), (row["task"], *head), row["iqm"])
            for at, row in enumerate(own)
            if row and not knows(row["method"])
        ]
        header += [" ".join(head), "paper"]
        columns += [[NOTHING if row is None else show(row) for row in own] for show in (_halved, _paper)]
    header.append("n")
    columns.append([counts(by_asked.values()) for by_asked in by_place.values()])
    return Grid(tuple(header), tuple(zip(*columns, strict=True)), words, highest(best))


def _key(row: Mapping[str, Any], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(row[name] for name in names)


def _family(method: str) -> str:
    """The method without the learner it builds on, as the paper's rows are named."""
    if method in _BASELINES:
        return _BASELINE
    residual = _RESIDUAL.fullmatch(method)
    return f"rrm-{residual[1]}" if residual else method


def _halved(row: Row) -> str:
    return plus_minus(row["iqm"], (row["high"] - row["low"]) / 2, row["score"])


def _notes(section: Section, rows: Sequence[Row]) -> Iterator[str]:
    places = [column.name for column in (TASK, TEACHER, FEEDBACK) if column.tells(rows)]
    steps = {" ".join(_key(row, places)): row["step"] for row in rows}
    yield f"Read at the last common step: {', '.join(f'{name} at {step:,}' for name, step in steps.items())}."
    yield f"Paper: {published.source(EXPERIMENT)}, at the paper's scale; ours is profile {section.profile}."
