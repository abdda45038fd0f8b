"""A report ready to be written: raw values for programs, text for people, and the words that must stand beside them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.labels import knows
from rrmctl.reports.statistics import SURE
from rrmctl.stats import MIN_RUNS

if TYPE_CHECKING:
    import pandas as pd

    from rrm.envs.tasks import ScoreKind
    from rrmctl.reports.series import Section

#: Stands where there is nothing to say.
NOTHING = "–"
#: Heading of the intervals of the estimates beside them.
INTERVAL = f"{SURE} interval"

#: Row and column.
Cell = tuple[int, int]


class NoDataError(UserError):
    """A table has nothing to show of these sections."""


@dataclass(frozen=True)
class Grid:
    """A table as people read it."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1  #: so many columns from the left hold names, the others numbers
    best: frozenset[Cell] = frozenset()  #: (row, column) of what is to be set in bold

    def __post_init__(self) -> None:
        assert all(len(row) == len(self.header) for row in self.rows)

    @classmethod
    def of(cls, columns: dict[str, Sequence[str]], *, words: int, best: frozenset[Cell] = frozenset()) -> Grid:
        """From columns of text, by heading."""
        return cls(tuple(columns), tuple(zip(*columns.values(), strict=True)), words, best)

    def ends(self) -> list[bool]:
        """For each row, whether it is the last of those that share its first column and another group follows."""
        starts = [here[0] != before[0] for before, here in zip(self.rows, self.rows[1:], strict=False)]
        grouped = not all(starts)  # lines between all rows would part nothing
        return [*(start and grouped for start in starts), False] if self.rows else []

    def named_once(self) -> list[tuple[str, ...]]:
        """The rows, with a name in the first column only where a group of them begins."""
        begins = [True, *(here[0] != before[0] for before, here in zip(self.rows, self.rows[1:], strict=False))]
        return [row if begins[at] else ("", *row[1:]) for at, row in enumerate(self.rows)]


def tells_apart(table: pd.DataFrame, name: str, within: Sequence[str] = ("task",)) -> bool:
    """Whether a column tells rows of equal `within` from one another."""
    return bool((table.groupby(list(within))[name].nunique() > 1).any())


def place_columns(table: pd.DataFrame) -> dict[str, Sequence[str]]:
    """The task of each row, and its teacher and schedule of feedback where some task has several, by heading."""
    names = ["task", *(name for name in ("teacher", "feedback") if tells_apart(table, name))]
    return {name.capitalize(): list(table[name]) for name in names}


def highest(entries: Iterable[tuple[Cell, Hashable, float]]) -> frozenset[Cell]:
    """The cells with the greatest number of their group; equals all count, NaN never does.

    Args:
        entries: cells, the group in which each is compared, and its number.
    """
    groups: dict[Hashable, dict[Cell, float]] = defaultdict(dict)
    for cell, group, value in entries:
        if not math.isnan(value):
            groups[group][cell] = value
    tops = [(group, max(group.values())) for group in groups.values()]
    return frozenset(c for group, top in tops for c, v in group.items() if math.isclose(v, top, abs_tol=1e-12))


def best_methods(table: pd.DataFrame, value: str, by: Sequence[str], column: int) -> frozenset[Cell]:
    """The cells of the best methods of a table with a row for each, the oracle and its variants outside it.

    Args:
        table: with a column `method`.
        value: the column to compare.
        by: the columns that tell one comparison from another.
        column: of the grid.
    """
    groups = table[list(by)].itertuples(index=False, name=None)
    rows = enumerate(zip(groups, table["method"], table[value], strict=True))
    return highest(((at, column), group, number) for at, (group, method, number) in rows if not knows(method))


@dataclass(frozen=True, eq=False)
class Report:
    """One table with everything without which it must not be shown."""

    title: str
    table: pd.DataFrame  #: raw values: success as a fraction, returns as they are, nothing as NaN
    grid: Grid
    notes: tuple[str, ...]
    facts: dict[str, Any]  #: what the notes say, in JSON values; experiment, profile and variant among them


def counts(rows: Iterable[Mapping[Any, Any]]) -> str:
    """Runs of those planned, of each of several rows in one cell; once where all have equally many."""
    return ", ".join(dict.fromkeys(f"{row['n']}/{row['planned']}" for row in rows))


def some(reports: list[Report], sections: Sequence[Section], lacking: str, hint: str) -> list[Report]:
    """The reports of a kind, if there are any.

    Args:
        sections: that were asked about.
        lacking: what they have none of.
        hint: what to do about that.

    Raises:
        NoDataError: there is none.
    """
    if not reports:
        names = ", ".join(dict.fromkeys(section.experiment for section in sections))
        raise NoDataError(f"{names}: {lacking}", hint)
    return reports


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
