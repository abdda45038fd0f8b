"""Tables of the page: headed, captioned, sortable, and scrollable where the window is narrow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from rrmctl.reports.document import NOTHING, Grid
from rrmctl.reports.page.html import Html, element, joined

#: More rows of one table would make the page slow.
MOST_ROWS = 2_000
#: Columns that fit onto a sheet of paper held upright; more are printed across.
_PORTRAIT = 11
#: Letters beyond which a cell may be broken into lines.
_LONG = 40


class Column(NamedTuple):
    """A column of a table."""

    name: str
    number: bool = False  #: whether it is set and sorted as numbers
    show: Callable[[Any], str] = str


def of_grid(grid: Grid, caption: str) -> Html:
    """A report's table as people read it."""
    columns = [Column(name, number=at >= grid.words) for at, name in enumerate(grid.header)]
    rows = [
        [_cell(text, columns[at], best=(row, at) in grid.best) for at, text in enumerate(cells)]
        for row, cells in enumerate(grid.rows)
    ]
    return _table(columns, rows, caption)


def of_rows(columns: Sequence[Column], rows: Iterable[Sequence[Any]], caption: str, last: Sequence[Any] = ()) -> Html:
    """A table of values; None and NaN are missing.

    Args:
        last: a row of totals, which stays at the end.
    """
    made = [[_shown(value, column) for value, column in zip(row, columns, strict=True)] for row in rows]
    foot = [_shown(value, column) for value, column in zip(last, columns, strict=True)] if last else []
    return _table(columns, made, caption, foot)


def _shown(value: Any, column: Column) -> Html:
    """A cell; HTML stands as it is, and a number goes along exactly, to be sorted by."""
    import pandas as pd

    if isinstance(value, Html):
        return element("td", value)
    if pd.isna(value):
        return _cell(NOTHING, column)
    return _cell(column.show(value), column, raw=float(value) if column.number else None)


def _cell(text: str, column: Column, *, best: bool = False, raw: float | None = None) -> Html:
    content = element("strong", text) if best else text
    kind = "long" if len(text) > _LONG else _kind(column)
    return element("td", content, class_=kind, data_value=raw)


def _table(columns: Sequence[Column], rows: list[list[Html]], caption: str, foot: Sequence[Html] = ()) -> Html:
    heads = [
        element("th", element("button", each.name, type="button"), scope="col", class_=_kind(each)) for each in columns
    ]
    if len(rows) > MOST_ROWS:
        caption += f": the first {MOST_ROWS:,} of {len(rows):,} rows; `rrmctl export NAME --to csv -o DIR` writes all"
    table = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", element("tr", *heads)),
        element("tbody", joined(map(_row, rows[:MOST_ROWS]))),
        element("tfoot", _row(foot)) if foot else None,
    )
    # Focus lets a keyboard scroll what is wider than the window.
    wide = " wide" if len(columns) > _PORTRAIT else ""
    return element("div", table, class_=f"scroll{wide}", role="region", aria_label=caption, tabindex=0)


def _kind(column: Column) -> str | None:
    return "number" if column.number else None


def _row(cells: Sequence[Html]) -> Html:
    """The first cell heads its row."""
    first = Html(cells[0].replace("<td", '<th scope="row"', 1).removesuffix("</td>") + "</th>")
    return element("tr", first, *cells[1:])
