"""What cells of tables say, and the columns that many tables have."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence

from rrm.envs.tasks import ScoreKind
from rrmctl.labels import knows
from rrmctl.reports.report import NOTHING, Column, Grid, Row, highest
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


def of_planned(row: Row) -> str:
    """Runs of those planned."""
    return f"{row['n']}/{row['planned']}"


def counts(rows: Iterable[Row]) -> str:
    """Runs of those planned, of each of several rows in one cell; once where all have equally many."""
    return ", ".join(dict.fromkeys(map(of_planned, rows)))


def pivoted(
    rows: Sequence[Row],
    places: Sequence[Column],
    head: Callable[[Row], str],
    cells: Mapping[str, Callable[[Row], str]],
    *,
    best: tuple[str, Callable[[Row], Hashable]],
    beside: Sequence[Column] = (),
) -> Grid:
    """A table with a row for each place, and beside it what belongs to each of several heads; the runs stand last.

    Args:
        places: columns of words.
        head: what stands over a row's cells.
        cells: a row's texts by their heading, in which `{}` is the head.
        best: the name of the value whose highest is bold, and what rows have in common that are compared.
        beside: numbers of a place's first row, between the places and the heads.
    """
    shown, (value, compared) = [column for column in places if column.tells(rows)], best
    by_place: dict[tuple[str, ...], dict[str, Row]] = defaultdict(dict)
    for row in rows:
        by_place[tuple(column.text(row) for column in shown)][head(row)] = row
    heads = list(dict.fromkeys(map(head, rows)))
    names = [str(column.heading) for column in (*shown, *beside)]
    header = (*names, *(form.format(name) for name in heads for form in cells), "n")
    lines, entries = [], []
    for at, (place, own) in enumerate(by_place.items()):
        first = next(iter(own.values()))
        texts = (show(own[name]) if name in own else NOTHING for name in heads for show in cells.values())
        lines.append((*place, *(column.text(first) for column in beside), *texts, counts(own.values())))
        for name, row in own.items():
            if not knows(row["method"]):
                cell = (at, len(names) + len(cells) * heads.index(name))
                entries.append((cell, compared(row), row[value]))
    return Grid(header, tuple(lines), len(shown), highest(entries))


def estimated(
    name: str,
    heading: str,
    ends: str = "",
    over: str | None = INTERVAL,
    *,
    score: Callable[[Row], ScoreKind] = lambda row: row["score"],
    n: Callable[[Row], int] = lambda row: row["n"],
    best: bool = False,
) -> tuple[Column, Column, Column]:
    """The columns of `Estimate.row(name, ends)`: a number, and its interval with a heading of its own."""
    low, high = f"{ends}low", f"{ends}high"
    return (
        Column(name, NUMBER, heading, lambda row: number(row[name], score(row)), best=COMPARED if best else ()),
        Column(low, NUMBER, over, lambda row: interval(row[low], row[high], score(row), n(row))),
        Column(high, NUMBER),
    )


def step(row: Row) -> str:
    """The step at which a row is read."""
    return f"{row['step']:,}"


#: What tells one comparison of methods from another.
COMPARED = ("task", "teacher", "feedback")
#: Columns of many tables: of which runs a row is, at which step it is read, quartiles and number of runs.
PLACE = (
    Column("task", TEXT, "Task"),
    Column("teacher", TEXT, "Teacher", apart=("task",)),
    Column("feedback", TEXT, "Feedback", apart=("task",)),
)
METHOD, SCORE = Column("method", TEXT, "Method"), Column("score")
STEP = Column("step", WHOLE, "Step", step)
QUARTILES = (
    Column("q25", NUMBER, "25-75 %", lambda row: spread(row["q25"], row["q75"], row["score"], "{}..{}")),
    Column("q75", NUMBER),
)
RUNS = (Column("n", WHOLE, "n", of_planned), Column("planned", WHOLE))
