"""A report ready to be written: raw values for programs, text for people, and the words that must stand beside them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.labels import knows
from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.statistics import Statistics
from rrmctl.store.frame import TEXT, frame

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.reports.series import Section

#: Stands where there is nothing to say.
NOTHING = "–"

#: Row and column.
Cell = tuple[int, int]

#: A row of a table: raw values by the name of their column; what is missing is not there, or NaN.
Row = Mapping[str, Any]


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
    def of(cls, columns: Sequence[Column], rows: Sequence[Row]) -> Grid:
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

    def ends(self) -> list[bool]:
        """For each row, whether it is the last of those that share its first column and another group follows."""
        starts = [here[0] != before[0] for before, here in zip(self.rows, self.rows[1:], strict=False)]
        grouped = not all(starts)  # lines between all rows would part nothing
        return [*(start and grouped for start in starts), False] if self.rows else []

    def named_once(self) -> list[tuple[str, ...]]:
        """The rows, with a name in the first column only where a group of them begins."""
        begins = [True, *(here[0] != before[0] for before, here in zip(self.rows, self.rows[1:], strict=False))]
        return [row if begins[at] else ("", *row[1:]) for at, row in enumerate(self.rows)]


def highest(entries: Iterable[tuple[Cell, Hashable, float]]) -> frozenset[Cell]:
    """The cells with the greatest number of their group, from (cell, group, number); equals all count, NaN never."""
    groups: dict[Hashable, dict[Cell, float]] = defaultdict(dict)
    for cell, group, value in entries:
        if not math.isnan(value):
            groups[group][cell] = value
    tops = [(group, max(group.values())) for group in groups.values()]
    return frozenset(c for group, top in tops for c, v in group.items() if math.isclose(v, top, abs_tol=1e-12))


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


@dataclass(frozen=True, eq=False)
class Report:
    """One table with everything without which it must not be shown."""

    title: str
    table: pd.DataFrame  #: raw values: success as a fraction, returns as they are, nothing as NaN
    grid: Grid
    notes: tuple[str, ...]
    facts: dict[str, Any]  #: what the notes say, in JSON values; experiment, profile and variant among them


def section_report(
    section: Section,
    settings: Statistics,
    columns: Sequence[Column],
    rows: Iterable[Row],
    *,
    grid: Callable[[list[Row]], Grid] | None = None,
    notes: Iterable[str] = (),
    **more: Any,
) -> Report:
    """The report of one section.

    Args:
        grid: the table for people, where it is not the columns that have a heading.
        notes: what is particular to it beside what it contains and how it was made.
        more: facts beside those of every table.
    """
    table, whole = tabled(columns, rows)
    words = (*contents_notes(section), *notes, *statistics_notes(section, settings))
    text = Grid.of(columns, whole) if grid is None else grid(whole)
    return Report(title(section), table, text, words, facts(section, settings) | more)


def tabled(columns: Sequence[Column], rows: Iterable[Row]) -> tuple[pd.DataFrame, list[Row]]:
    """The values of these columns as a frame, and the rows with NaN for what is missing."""
    kinds = {column.name: column.kind for column in columns}
    whole: list[Row] = [dict.fromkeys(kinds, math.nan) | dict(row) for row in rows]
    return frame(whole, kinds), whole


def some(reports: list[Report], sections: Sequence[Section], lacking: str, hint: str) -> list[Report]:
    """The reports of a kind; without any, a `NoDataError` that says what the sections lack and what to do."""
    if not reports:
        names = ", ".join(dict.fromkeys(section.experiment for section in sections))
        raise NoDataError(f"{names}: {lacking}", hint)
    return reports
