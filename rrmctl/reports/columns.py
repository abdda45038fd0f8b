"""What cells of tables say, and the columns that many tables have."""

from __future__ import annotations

import math
from collections.abc import Iterable

from rrm.envs.tasks import ScoreKind
from rrmctl.reports.report import NOTHING, Column, Row
from rrmctl.reports.statistics import SURE
from rrmctl.stats import MIN_RUNS
from rrmctl.store.frame import NUMBER, TEXT, WHOLE

#: Heading of the intervals of the estimates beside them.
INTERVAL = f"{SURE} interval"


def number(value: float, score: ScoreKind) -> str:
    """Success as percent, a return with what digits it needs."""
    if math.isnan(value):
        return NOTHING
    if score == "success":
        return f"{100 * value:.1f} %"
    return f"{value:.{0 if abs(value) >= 1000 else 1 if abs(value) >= 100 else 2}f}"


def spread(low: float, high: float, score: ScoreKind, form: str = "[{}, {}]") -> str:
    """Two numbers in one cell; the sign for percent stands in the column of the estimate."""
    if math.isnan(low):
        return NOTHING
    return form.format(*(number(end, score).removesuffix(" %") for end in (low, high)))


def interval(low: float, high: float, score: ScoreKind, n: int) -> str:
    """An interval as [low, high], or why there is none.

    Args:
        n: runs behind it; of several tasks in all, each of which needs as many as one.
    """
    if n > 0 and math.isnan(low):
        return f"n < {MIN_RUNS}" + (" on a task" if n >= MIN_RUNS else "")
    return spread(low, high, score)


def plus_minus(value: float, half: float, score: ScoreKind) -> str:
    """The paper's form: a value and half the width of its interval, in percent for success; the value where none is."""
    if math.isnan(value):
        return NOTHING
    middle = number(value, score).removesuffix(" %")
    return middle if math.isnan(half) else f"{middle} ± {number(half, score).removesuffix(' %')}"


def runs(row: Row) -> str:
    """Runs of those planned."""
    return f"{row['n']}/{row['planned']}"


def counts(rows: Iterable[Row]) -> str:
    """Runs of those planned, of each of several rows in one cell; once where all have equally many."""
    return ", ".join(dict.fromkeys(map(runs, rows)))


def scored(name: str, heading: str, *, best: bool = False) -> Column:
    """A score's column."""
    return Column(name, NUMBER, heading, lambda row: number(row[name], row["score"]), best=COMPARED if best else ())


def step(row: Row) -> str:
    """The step at which a row is read."""
    return f"{row['step']:,}"


#: What tells one comparison of methods from another.
COMPARED = ("task", "teacher", "feedback")
#: Columns of many tables: of which runs a row is, at which step it is read, its interval, quartiles and number of runs.
PLACE = (
    Column("task", TEXT, "Task"),
    Column("teacher", TEXT, "Teacher", apart=("task",)),
    Column("feedback", TEXT, "Feedback", apart=("task",)),
)
METHOD, SCORE = Column("method", TEXT, "Method"), Column("score")
STEP = Column("step", WHOLE, "Step", step)
ENDS = (
    Column("low", NUMBER, INTERVAL, lambda row: interval(row["low"], row["high"], row["score"], row["n"])),
    Column("high", NUMBER),
)
QUARTILES = (
    Column("q25", NUMBER, "25-75 %", lambda row: spread(row["q25"], row["q75"], row["score"], "{}..{}")),
    Column("q75", NUMBER),
)
RUNS = (Column("n", WHOLE, "n", runs), Column("planned", WHOLE))
