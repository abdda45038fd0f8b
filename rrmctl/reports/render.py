"""Reports as text: terminal, Markdown, CSV, LaTeX and JSON.

For people success is in percent, and every table carries its title and what is particular to it in notes; the rest
is said by `rrmctl report explain`. CSV and JSON carry raw values (success as a fraction, missing as empty or null) and
the same facts in columns and keys.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.terminal import console

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console
    from rich.text import Text

    from rrmctl.reports.report import Grid, Report

#: Of the JSON document and the CSV columns; raised by one when one is added, removed, or changes its meaning.
TEXT_VERSION = 2

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
        for at, (row, last) in enumerate(zip(grid.named_once(), grid.ends(), strict=True)):
            table.add_row(
                *[_emphasised(cell, (at, column) in grid.best) for column, cell in enumerate(row)], end_section=last
            )
        console.print(Text(report.title, style="bold"))
        if grid.rows:
            console.print(table)
        for note in report.notes:
            console.print(Text(note, style="dim"))
        console.print()
    if any(report.grid.rows for report in reports):
        console.print(Text("Columns, intervals and bold: rrmctl report explain", style="dim"))


def _emphasised(text: str, best: bool) -> Text:
    from rich.text import Text

    return Text(text, style="bold" if best else "")


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
        body = _cells(grid, grid.rows, _cell, "**{}**")
        lines = ["| " + " | ".join(row) + " |" for row in (map(_cell, grid.header), rule, *body)]
        notes = [f"- {_escape(note, '*_')}" for note in report.notes]
        table = [*lines, ""] if grid.rows else []
        parts.append("\n".join([f"### {_escape(report.title, '*_')}", "", *table, *notes]).rstrip())
    return "\n\n".join(parts) + "\n"


def _cells(grid: Grid, rows: Sequence[Sequence[str]], escape: Callable[[str], str], bold: str) -> Iterator[list[str]]:
    """The rows with every cell escaped, and the best ones in bold."""
    for at, row in enumerate(rows):
        cells = enumerate(map(escape, row))
        yield [bold.format(cell) if (at, column) in grid.best else cell for column, cell in cells]


def _cell(text: str) -> str:
    return _escape(text, "\\|*_")


def _escape(text: str, signs: str) -> str:
    for sign in signs:
        text = text.replace(sign, f"\\{sign}")
    return text


_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", "–": "--",
    "|": r"\textbar{}", '"': "''",
    "−": "$-$", "±": r"$\pm$", "≥": r"$\ge$", "≤": r"$\le$", "×": r"$\times$",
    "·": r"\textperiodcentered{}",
}  # fmt: skip


#: What a document has to load for the tables.
LATEX_PACKAGES = ("booktabs", "graphicx", "longtable")
#: Rows of a table that floats; more go over several pages. There: letters of a cell that stays on one line, the share
#: of the text that columns with longer ones get, and between which lengths that is shared out in proportion.
_FLOATING, _LETTERS, _FOLDED, _WEIGHTS = 30, 14, 0.62, (34, 60)


def _latex(reports: Sequence[Report]) -> str:
    r"""Tables for a document that loads the packages `LATEX_PACKAGES`; none is wider than the text."""
    needs = f"% \\usepackage{{{','.join(LATEX_PACKAGES)}}}"
    return "\n\n".join([needs, *("\n".join(_latex_lines(report)) for report in reports)]) + "\n"


def _latex_lines(report: Report) -> Iterator[str]:
    yield f"% {json.dumps(report.facts, sort_keys=True)}"
    notes = _tex(" ".join(report.notes))
    if not report.grid.rows:
        yield from (rf"\paragraph{{{_tex(report.title)}}}", notes)
    elif len(report.grid.rows) > _FLOATING:
        yield from _long_table(report)
        yield from [rf"{{\footnotesize {notes}\par}}"] if notes else []
    else:
        yield from (r"\begin{table}", r"\centering", rf"\caption{{{_tex(report.title)}}}")
        yield r"\resizebox{\ifdim\width>\textwidth\textwidth\else\width\fi}{!}{%"
        yield from _tabular(report.grid)
        yield from ("}", *((r"\par\smallskip\footnotesize", notes) if notes else ()), r"\end{table}")


def _tabular(grid: Grid) -> Iterator[str]:
    alignment = "".join("l" if column < grid.words else "r" for column in range(len(grid.header)))
    yield from (rf"\begin{{tabular}}{{{alignment}}}", r"\toprule", _latex_row(map(_tex, grid.header)), r"\midrule")
    yield from _latex_body(grid)
    yield from (r"\bottomrule", r"\end{tabular}")


def _long_table(report: Report) -> Iterator[str]:
    """Over several pages, with names that are broken into lines."""
    grid = report.grid
    longest = [max(len(row[column]) for row in grid.rows) for column in range(grid.words)]
    weights = [min(max(length, _WEIGHTS[0]), _WEIGHTS[1]) if length > _LETTERS else 0 for length in longest]
    columns = [rf"p{{{_FOLDED * w / sum(weights):.3f}\textwidth}}" if w else "l" for w in weights]
    alignment = "".join(columns) + "r" * (len(grid.header) - grid.words)
    yield r"{\scriptsize\setlength{\tabcolsep}{2pt}"
    yield rf"\begin{{longtable}}{{{alignment}}}"
    yield rf"\caption{{{_tex(report.title)}}}\\"
    yield from (r"\toprule", _latex_row(map(_tex, grid.header)), r"\midrule", r"\endhead")
    yield from _latex_body(grid)
    yield from (r"\bottomrule", r"\end{longtable}}")


def _latex_body(grid: Grid) -> Iterator[str]:
    body = _cells(grid, grid.named_once(), _tex, r"\textbf{{{}}}")
    for row, last in zip(body, grid.ends(), strict=True):
        yield _latex_row(row)
        if last:
            yield r"\midrule"


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _tex(text: str) -> str:
    return "".join(_TEX.get(sign, sign) for sign in text)


def _csv(reports: Sequence[Report]) -> str:
    """All reports in one table; what belongs to a whole report is repeated in each of its rows.

    A report of words alone has one row, of these.
    """
    import pandas as pd

    plain = ("experiment", "profile", "variant")
    tables = []
    for report in reports:
        facts = {key: value if _is_plain(value) else json.dumps(value) for key, value in report.facts.items()}
        rest = {key: value for key, value in facts.items() if key not in plain}
        rows = report.table if len(report.table.columns) else pd.DataFrame(index=[0])
        table = rows.assign(**facts, schema_version=TEXT_VERSION)
        tables.append(table[[*plain, *report.table.columns, *rest, "schema_version"]])
    text: str = pd.concat(tables, ignore_index=True).to_csv(index=False, lineterminator="\n")
    return text


def _is_plain(value: Any) -> bool:
    return isinstance(value, str | int | float)


def _json(reports: Sequence[Report]) -> str:
    document = [
        report.facts | {"title": report.title, "notes": list(report.notes), "rows": _rows(report.table)}
        for report in reports
    ]
    whole = {"schema_version": TEXT_VERSION, "reports": document}
    return json.dumps(whole, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of plain values; null where there is none."""
    whole = table.astype(object).where(table.notna(), None)
    return [{str(key): value for key, value in row.items()} for row in whole.to_dict("records")]


FORMATS: dict[str, Callable[[Sequence[Report]], str]] = {
    "terminal": _terminal,
    "markdown": _markdown,
    "csv": _csv,
    "latex": _latex,
    "json": _json,
}
