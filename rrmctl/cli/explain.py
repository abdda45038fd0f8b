"""`rrmctl report explain`: what holds of every table, said once."""

from __future__ import annotations

from typing import Annotated

import typer

from rrmctl.reports.plugins import choose
from rrmctl.reports.tables import explained, kinds
from rrmctl.terminal import stdout_console


def explain(
    table: Annotated[
        str | None, typer.Argument(metavar="TABLE", help=f"One of {', '.join(kinds())}. Default: all.")
    ] = None,
) -> None:
    """What the columns of tables mean and how their numbers are made; notes below a table say what is otherwise."""
    from rich.text import Text

    from rrmctl.reports.render import WIDE

    if table is not None:
        choose(kinds(), table, "table")
    console = stdout_console(WIDE)
    for title, sentences in explained(table).items():
        console.print(Text(title, style="bold"))
        console.print(*map(Text, sentences), "", sep="\n")
