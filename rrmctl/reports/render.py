"""Reports as text: terminal, Markdown, CSV, LaTeX and JSON.

For people success is in percent and every table carries its title and notes. CSV and JSON carry raw values (success
as a fraction, missing as empty or null) and the same facts in columns and keys.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.reports.tables import COLUMNS
from rrmctl.reports.words import LAST_MARK

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from rrmctl.reports.words import Report

#: Of the JSON document and the CSV columns; raised by one when one is added, removed, or changes its meaning.
TEXT_VERSION = 1

_NOTHING = "–"
#: Columns of a terminal: the usual number, enough for space between the columns, and what is taken where nobody looks.
_USUAL, _ROOMY, _WIDE = 80, 100, 160
_LEFT = ("task", "teacher", "feedback", "method")


def print_terminal(reports: Sequence[Report], console: Console) -> None:
    """Print the reports as tables with notes below; what does not fit into the width is folded, never cut off."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    for report in reports:
        header, rows = cells(report.table)
        table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, int(console.width >= _ROOMY)))
        for name in header:
            text = name.lower() in _LEFT
            # Names fold first; numbers only where even the narrowest of terminals leaves no choice.
            whole = not text and console.width >= _USUAL
            table.add_column(name, justify="left" if text else "right", overflow="fold", no_wrap=whole)
        for row, last in zip(*_grouped(rows), strict=True):
            table.add_row(*row, end_section=last)
        console.print(Text(report.title, style="bold"))
        if rows:
            console.print(table)
        for note in report.notes:
            console.print(Text(note, style="dim"))
        console.print()


def _grouped(rows: Sequence[Sequence[str]]) -> tuple[list[list[str]], list[bool]]:
    """The rows with each task named once, and which of them end a task."""
    tasks = [row[0] for row in rows]
    starts = [here != before for here, before in zip(tasks, [None, *tasks], strict=False)]
    named = [[row[0] if first else "", *row[1:]] for row, first in zip(rows, starts, strict=True)]
    return named, [*starts[1:], False] if starts else []


def console_for(file: Any = None) -> Console:
    """A console for reports: as wide as the terminal, and wide enough for any table where nobody looks.

    Colours follow the terminal, NO_COLOR and FORCE_COLOR; a given file gets none.
    """
    from rich.console import Console

    if file is not None:
        return Console(file=file, width=_WIDE, no_color=True, force_terminal=False, highlight=False)
    console = Console(highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _WIDE
    return console


def to_text(reports: Sequence[Report], form: str) -> str:
    """The reports as text ending in a newline; `form` is one of `FORMATS`."""
    return FORMATS[form](reports)


def _terminal(reports: Sequence[Report]) -> str:
    file = io.StringIO()
    print_terminal(reports, console_for(file))
    return "\n".join(line.rstrip() for line in file.getvalue().rstrip().splitlines()) + "\n"


def cells(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Header and rows of an IQM table for people; columns that say nothing are left out."""
    columns: dict[str, list[str]] = {"Task": list(table["task"])}
    for name in ("teacher", "feedback"):
        if (table.groupby("task")[name].nunique() > 1).any():
            columns[name.capitalize()] = list(table[name])
    records = table.to_dict("records")
    columns["Method"] = list(table["method"])
    columns["Step"] = [_step(row) for row in records]
    columns["IQM"] = [_number(row["iqm"], row["score"]) for row in records]
    columns["95 % interval"] = [_interval(row) for row in records]
    columns["25-75 %"] = [_range(row["q25"], row["q75"], row["score"], "{}..{}") for row in records]
    columns["n"] = [f"{row['n']}/{row['planned']}" for row in records]
    columns["AUC"] = [_number(row["auc"], row["score"]) for row in records]
    return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]


def _step(row: dict[Any, Any]) -> str:
    if row["step_rule"] == "each":
        return _NOTHING
    return f"{row['step']:,}" + (LAST_MARK if row["step_rule"] == "last" else "")


def _number(value: float, score: str) -> str:
    """Success as percent, a return with what digits it needs."""
    if math.isnan(value):
        return _NOTHING
    if score == "success":
        return f"{100 * value:.1f} %"
    return f"{value:.{0 if abs(value) >= 1000 else 1 if abs(value) >= 100 else 2}f}"


def _range(low: float, high: float, score: str, form: str) -> str:
    """Two numbers in one cell; the sign for percent stands in the column of the estimate."""
    if math.isnan(low):
        return _NOTHING
    return form.format(*(_number(end, score).removesuffix(" %") for end in (low, high)))


def _interval(row: dict[Any, Any]) -> str:
    too_few = row["n"] > 0 and math.isnan(row["low"])
    return "n < 3" if too_few else _range(row["low"], row["high"], row["score"], "[{}, {}]")


def _markdown(reports: Sequence[Report]) -> str:
    parts = []
    for report in reports:
        header, rows = cells(report.table)
        rule = [":--" if name.lower() in _LEFT else "--:" for name in header]
        grid = [header, rule, *[[_escape(cell, "|*_") for cell in row] for row in rows]]
        lines = ["| " + " | ".join(row) + " |" for row in grid]
        notes = [f"- {_escape(note, '*_')}" for note in report.notes]
        parts.append("\n".join([f"### {_escape(report.title, '*_')}", "", *lines, "", *notes]))
    return "\n\n".join(parts) + "\n"


def _escape(text: str, signs: str) -> str:
    for sign in signs:
        text = text.replace(sign, f"\\{sign}")
    return text


_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", "–": "--",
    "·": r"\textperiodcentered{}",
}  # fmt: skip


def _latex(reports: Sequence[Report]) -> str:
    """Tables for a document that loads the package booktabs."""
    return "\n\n".join("\n".join(_latex_lines(report)) for report in reports) + "\n"


def _latex_lines(report: Report) -> Iterator[str]:
    header, rows = cells(report.table)
    alignment = "".join("l" if name.lower() in _LEFT else "r" for name in header)
    yield f"% {json.dumps(report.facts, sort_keys=True)}"
    yield from (r"\begin{table}", r"\centering", rf"\caption{{{_tex(report.title)}}}")
    yield from (rf"\begin{{tabular}}{{{alignment}}}", r"\toprule", " & ".join(map(_tex, header)) + r" \\", r"\midrule")
    for row, last in zip(*_grouped(rows), strict=True):
        yield " & ".join(map(_tex, row)) + r" \\"
        if last:
            yield r"\midrule"
    yield from (r"\bottomrule", r"\end{tabular}", r"\par\smallskip\footnotesize")
    yield _tex(" ".join(report.notes))
    yield r"\end{table}"


def _tex(text: str) -> str:
    return "".join(_TEX.get(sign, sign) for sign in text)


def _csv(reports: Sequence[Report]) -> str:
    """All reports in one table; what belongs to a whole report is repeated in each of its rows."""
    import pandas as pd

    plain = ("experiment", "profile", "variant")
    tables = []
    for report in reports:
        facts = {key: value if _is_plain(value) else json.dumps(value) for key, value in report.facts.items()}
        rest = {key: value for key, value in facts.items() if key not in plain}
        table = report.table.assign(**facts, schema_version=TEXT_VERSION)
        tables.append(table[[*plain, *COLUMNS, *rest, "schema_version"]])
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
