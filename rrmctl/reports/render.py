"""Reports as text: terminal, Markdown, CSV, LaTeX and JSON.

For people success is in percent, and every table carries its title and what is particular to it in notes; the rest
is said by `rrmctl report explain`. CSV and JSON carry raw values (success as a fraction, missing as empty or null) and
the same facts in columns and keys.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from rrmctl.terminal import console

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.reports.columns import TextGrid
    from rrmctl.reports.report import Report

#: Of the JSON document and the CSV columns; raised by one when one is added, removed, or changes its meaning.
TEXT_VERSION = 3

#: Columns of a terminal: the usual number, enough for space between the columns, and what is taken where nobody looks.
_USUAL, _ROOMY, WIDE = 80, 100, 160


def print_terminal(reports: Sequence[Report], console: Console) -> None:
    """Print the reports as tables with notes below; what does not fit into the width is folded, never cut off."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    for report in reports:
        grid = report.grid
        table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, int(console.width >= _ROOMY)))
        for column, name in enumerate(grid.header):
            text = column < grid.words
            # Names fold first; numbers only where even the narrowest of terminals leaves no choice.
            whole = not text and console.width >= _USUAL
            table.add_column(name, justify="left" if text else "right", overflow="fold", no_wrap=whole)
        for at, (row, last) in enumerate(grid.grouped()):
            styles = ["bold" if (at, column) in grid.best else "" for column in range(len(row))]
            table.add_row(*map(Text, row, styles), end_section=last)
        console.print(Text(report.title, style="bold"))
        if grid.rows:
            console.print(table)
        for note in report.notes:
            console.print(Text(note, style="dim"))
        console.print()
    if any(report.grid.rows for report in reports):
        console.print(Text("Columns, intervals and bold: rrmctl report explain", style="dim"))


def to_text(reports: Sequence[Report], form: str) -> str:
    """The reports as text ending in a newline; `form` is one of `FORMATS`."""
    return FORMATS[form](reports)


def _terminal(reports: Sequence[Report]) -> str:
    file = io.StringIO()
    print_terminal(reports, console(file, width=WIDE, no_color=True, force_terminal=False))
    return "\n".join(line.rstrip() for line in file.getvalue().rstrip().splitlines()) + "\n"


def _markdown(reports: Sequence[Report]) -> str:
    parts = []
    for report in reports:
        grid = report.grid
        rule = [":--" if column < grid.words else "--:" for column in range(len(grid.header))]
        body = (_cells(grid, at, row, _CELL, "**{}**") for at, row in enumerate(grid.rows))
        lines = [
            "| " + " | ".join(row) + " |" for row in ([name.translate(_CELL) for name in grid.header], rule, *body)
        ]
        notes = [f"- {note.translate(_PROSE)}" for note in report.notes]
        table = [*lines, ""] if grid.rows else []
        parts.append("\n".join([f"### {report.title.translate(_PROSE)}", "", *table, *notes]).rstrip())
    return "\n\n".join(parts) + "\n"


def _cells(grid: TextGrid, at: int, row: Sequence[str], signs: dict[int, str], bold: str) -> list[str]:
    """A row with every cell escaped, and the best ones in bold."""
    cells = enumerate(text.translate(signs) for text in row)
    return [bold.format(cell) if (at, column) in grid.best else cell for column, cell in cells]


_CELL, _PROSE = (str.maketrans({sign: f"\\{sign}" for sign in signs}) for signs in ("\\|*_", "*_"))

_TEX = str.maketrans({
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", "–": "--",
    "|": r"\textbar{}", '"': "''",
    "−": "$-$", "±": r"$\pm$", "≥": r"$\ge$", "≤": r"$\le$", "×": r"$\times$",
    "·": r"\textperiodcentered{}",
})  # fmt: skip

#: What a document has to load for the tables.
LATEX_PACKAGES = ("booktabs", "graphicx", "longtable")
#: Rows of a table that floats; more go over several pages. There: letters of a cell that stays on one line, the share
#: of the text that columns with longer ones get, and between which lengths that is shared out in proportion.
_FLOATING, _LETTERS, _FOLDED, _WEIGHTS = 30, 14, 0.62, (34, 60)


def _latex(reports: Sequence[Report]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(  # noqa: S701 (no HTML: a filter escapes what TeX takes for its own)
        loader=PackageLoader("rrmctl.reports", ""), undefined=StrictUndefined, extensions=["jinja2.ext.loopcontrols"],
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, block_start_string="<%",
        block_end_string="%>", variable_start_string="<<", variable_end_string=">>", comment_start_string="<#",
        comment_end_string="#>",
    )  # fmt: skip
    environment.filters |= {"tex": lambda text: text.translate(_TEX), "json": partial(json.dumps, sort_keys=True)}
    tables = []
    for report in reports:
        grid, long = report.grid, len(report.grid.rows) > _FLOATING
        rows = [(_cells(grid, at, row, _TEX, r"\textbf{{{}}}"), last) for at, (row, last) in enumerate(grid.grouped())]
        words = _folding(grid) if long else "l" * grid.words
        tables.append((report, rows, words + "r" * (len(grid.header) - grid.words), long))
    return environment.get_template("latex.jinja").render(tables=tables, packages=LATEX_PACKAGES)


def _folding(grid: TextGrid) -> str:
    """The alignment of names in a table over several pages: long ones are broken into lines."""
    longest = [max(len(row[column]) for row in grid.rows) for column in range(grid.words)]
    weights = [min(max(length, _WEIGHTS[0]), _WEIGHTS[1]) if length > _LETTERS else 0 for length in longest]
    return "".join(rf"p{{{_FOLDED * w / sum(weights):.3f}\textwidth}}" if w else "l" for w in weights)


def _csv(reports: Sequence[Report]) -> str:
    """All reports in one table; what belongs to a whole report is repeated in each of its rows.

    A report of words alone has one row, of these.
    """
    import pandas as pd

    first, tables = ("experiment", "profile", "variant"), []
    for report in reports:
        facts = report.facts | {"schema_version": TEXT_VERSION}
        texts = {key: fact if isinstance(fact, str | int | float) else json.dumps(fact) for key, fact in facts.items()}
        rows = report.table if len(report.table.columns) else pd.DataFrame(index=[0])
        table = rows.assign(**texts)
        tables.append(table[[*first, *(name for name in table.columns if name not in first)]])
    text: str = pd.concat(tables, ignore_index=True).to_csv(index=False, lineterminator="\n")
    return text


def _json(reports: Sequence[Report]) -> str:
    document = []
    for report in reports:
        table = report.table.astype(object).where(report.table.notna(), None)  # null where there is none
        notes = {"title": report.title, "notes": list(report.notes)}
        document.append(report.facts | notes | {"rows": table.to_dict("records")})
    whole = {"schema_version": TEXT_VERSION, "reports": document}
    return json.dumps(whole, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


FORMATS: dict[str, Callable[[Sequence[Report]], str]] = {
    "terminal": _terminal, "markdown": _markdown, "csv": _csv, "latex": _latex, "json": _json,
}  # fmt: skip
