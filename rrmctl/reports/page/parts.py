"""What the page consists of: parts with texts, figures and tables. The template `page.html` shows them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import pandas as pd

from rrmctl.reports.columns import NOTHING

PageRow = Mapping[Any, Any] | Sequence[Any]


class PageColumn(NamedTuple):
    """A column of a table."""

    name: str
    field: str | int  #: of its rows
    number: bool = False  #: whether it is set and sorted as numbers
    show: Callable[[Any], str] = str

    def text(self, value: Any) -> str:
        """A cell; None and NaN are missing."""
        return NOTHING if pd.isna(value) else self.show(value)


@dataclass(frozen=True)
class Table:
    """A table that sorts, and that scrolls within itself where the window is narrow; one without rows is left out."""

    caption: str
    columns: Sequence[PageColumn]
    rows: Sequence[PageRow]  #: the first cell of one with a `link` leads to the part of that id
    total: PageRow = ()  #: stays at the end
    best: frozenset[tuple[int, int]] = frozenset()  #: row and field of what is to be set in bold

    def __bool__(self) -> bool:
        return bool(self.rows)


class Picture(NamedTuple):
    """A figure with its caption; pressing it enlarges it."""

    id: str
    caption: str
    alternative: str  #: said where it cannot be seen
    width: int  #: pixels
    source: str  #: itself, as a URL


@dataclass(frozen=True, kw_only=True)
class Part:
    """A piece of the page with what it shows, in this order; one that shows nothing is left out."""

    id: str = ""
    title: str = ""
    folded: bool = False  #: until somebody presses its title
    paragraphs: Sequence[str] = ()
    warnings: Sequence[str] = ()
    failures: Sequence[tuple[str, str]] = ()  #: a reason, and the runs that it stopped
    figures: Sequence[Picture | str] = ()  #: a text says why one is not drawn
    tables: Sequence[Table] = ()
    commands: str = ""
    parts: Sequence[Part] = ()
    rules: Sequence[str] = ()
    notes: Sequence[str] = ()

    def __bool__(self) -> bool:
        return any(any(getattr(self, field.name)) for field in fields(self)[3:])  # after those that show nothing


def identifier(*words: str) -> str:
    """An id from words, to be used after a number sign: letters, digits and dashes. Other signs become their code."""
    plain = re.sub("[ _.]", "-", "-".join(words))
    return re.sub("[^A-Za-z0-9-]", lambda sign: f"-{ord(sign[0]):x}-", plain)
