"""A table as people read it: its columns, what their cells say, and the columns that many tables have."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from rrm.envs.tasks import ScoreKind
from rrmctl.labels import knows
from rrmctl.reports.statistics import SURE
from rrmctl.stats import MIN_RUNS
from rrmctl.store.frame import NUMBER, TEXT, WHOLE

#: Stands where there is nothing to say.
NOTHING = "–"

#: What tells one comparison of methods from another.
COMPARED = ("task", "teacher", "feedback")

#: A row of a table: raw values by the name of their column; what is missing is not there, or NaN.
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table, as programs and as people read it."""

    name: str  #: of its values in the rows
    kind: str = TEXT  #: their type, of `rrmctl.store.frame`
    heading: str | None = None  #: of their text; None: people do not see them
    show: Callable[[Row], str] | None = None  #: the text in a row; None: the value itself
    apart: Sequence[str] | None = None  #: people see it only where it tells rows apart that are equal in these columns
    best: Sequence[str] = ()  #: its highest value among rows that are equal in these is bold, the oracle's aside

    def text(self, row: Row) -> str:
        """Its cell for people."""
        return str(row[self.name]) if self.show is None else self.show(row)

    def tells(self, rows: Iterable[Row]) -> bool:
        """Whether it says anything to people of these rows."""
        if self.apart is None:
            return True
        keys = [tuple(row[name] for name in self.apart) for row in rows]
        return len({(key, row[self.name]) for key, row in zip(keys, rows, strict=True)}) > len(set(keys))


@dataclass(frozen=True)
class TextGrid:
    """A table as people read it."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1  #: so many columns from the left hold names, the others numbers
    best: frozenset[tuple[int, int]] = frozenset()  #: (row, column) of what is to be set in bold

    def __post_init__(self) -> None:
        assert all(len(row) == len(self.header) for row in self.rows)

    @classmethod
    def of(cls, columns: Sequence[Column], rows: Sequence[Row]) -> TextGrid:
        """What people see of these columns."""
        shown = [column for column in columns if column.heading and column.tells(rows)]
        words = len(list(takewhile(lambda column: column.kind == TEXT, shown)))
        entries = (
            ((at, place), (place, *(row[name] for name in column.best)), row[column.name])
            for place, column in enumerate(shown)
            for at, row in enumerate(rows)
            if column.best and not knows(row["method"])
        )
        cells = tuple(tuple(column.text(row) for column in shown) for row in rows)
        return cls(tuple(str(column.heading) for column in shown), cells, words, highest(entries))

    def grouped(self) -> Iterator[tuple[tuple[str, ...], bool]]:
        """The rows, the first cell empty where it repeats the one above; and whether a line parts it from the next."""
        names = [row[0] for row in self.rows]
        begins = [at == 0 or name != names[at - 1] for at, name in enumerate(names)]
        parted = not all(begins)  # lines between all rows would part nothing
        for row, first, last in zip(self.rows, begins, [*begins, False][1:], strict=True):
            yield row if first else ("", *row[1:]), last and parted


def highest(entries: Iterable[tuple[tuple[int, int], Hashable, float]]) -> frozenset[tuple[int, int]]:
    """The cells with the greatest number of their group, from (cell, group, number); equals all count, NaN never."""
    groups: dict[Hashable, dict[tuple[int, int], float]] = defaultdict(dict)
    for cell, group, value in entries:
        if not math.isnan(value):
            groups[group][cell] = value
    tops = [(group, max(group.values())) for group in groups.values()]
    return frozenset(c for group, top in tops for c, v in group.items() if math.isclose(v, top, abs_tol=1e-12))


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


def plus_minus(value: float, half: float, score: ScoreKind) -> str:
    """The paper's form: a value and half the width of its interval, in percent for success; the value where none is."""
    return number(value, score).removesuffix(" %") if math.isnan(half) else spread(value, half, score, "{} ± {}")


def of_planned(row: Row) -> str:
    """Runs of those planned."""
    return f"{row['n']}/{row['planned']}"


def pivoted(
    rows: Sequence[Row],
    places: Sequence[Column],
    head: Callable[[Row], str],
    cells: Mapping[str, Callable[[Row], str]],
    *,
    best: str,
    compared: Sequence[str] = COMPARED,
    beside: Sequence[Column] = (),
) -> TextGrid:
    """A table with a row for each place, and beside it what belongs to each of several heads; the runs stand last.

    Args:
        places: columns of words.
        head: what stands over a row's cells.
        cells: a row's texts by their heading, in which `{}` is the head.
        best: the name of the value whose highest among rows that are equal in what is `compared` is bold.
        beside: numbers of a place's first row, between the places and the heads.
    """
    shown = [column for column in places if column.tells(rows)]
    by_place: dict[tuple[str, ...], dict[str, Row]] = defaultdict(dict)
    for row in rows:
        by_place[tuple(column.text(row) for column in shown)][head(row)] = row
    heads = list(dict.fromkeys(map(head, rows)))
    names = [str(column.heading) for column in (*shown, *beside)]
    header = (*names, *(form.format(name) for name in heads for form in cells), "n")
    lines, entries = [], []
    for at, (place, own) in enumerate(by_place.items()):
        first = next(iter(own.values()))
        numbers = [column.text(first) for column in beside]
        numbers += [show(own[name]) if name in own else NOTHING for name in heads for show in cells.values()]
        runs = ", ".join(dict.fromkeys(map(of_planned, own.values())))  # once where all have equally many
        lines.append((*place, *numbers, runs))
        for name, row in own.items():
            if not knows(row["method"]):
                cell = (at, len(names) + len(cells) * heads.index(name))
                entries.append((cell, tuple(row[name] for name in compared), row[best]))
    return TextGrid(header, tuple(lines), len(shown), highest(entries))


def estimated(
    name: str,
    heading: str,
    ends: str = "",
    over: str | None = f"{SURE} interval",
    *,
    score: Callable[[Row], ScoreKind] = lambda row: row["score"],
    n: Callable[[Row], int] = lambda row: row["n"],
    best: bool = False,
) -> tuple[Column, Column, Column]:
    """The columns of `Estimate.row(name, ends)`: a number, and its interval with a heading of its own.

    Where there is none it says why; `n` counts the runs behind it, of several tasks in all.
    """
    low, high = f"{ends}low", f"{ends}high"

    def interval(row: Row) -> str:
        if n(row) > 0 and math.isnan(row[low]):
            return f"n < {MIN_RUNS}" + (" on a task" if n(row) >= MIN_RUNS else "")
        return spread(row[low], row[high], score(row))

    return (
        Column(name, NUMBER, heading, lambda row: number(row[name], score(row)), best=COMPARED if best else ()),
        Column(low, NUMBER, over, interval),
        Column(high, NUMBER),
    )


def step(row: Row) -> str:
    """The step at which a row is read."""
    return NOTHING if math.isnan(row["step"]) else f"{row['step']:,}"


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
