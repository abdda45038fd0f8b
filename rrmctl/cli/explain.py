"""`rrmctl report explain`: what holds of every table, said once."""

from __future__ import annotations

from typing import Annotated

import typer

from rrmctl.errors import UserError
from rrmctl.reports.kinds import explained, kinds


def explain(
    table: Annotated[
        str | None, typer.Argument(metavar="TABLE", help=f"One of {', '.join(kinds())}. Default: all.")
    ] = None,
) -> None:
    """What the columns of tables mean and how their numbers are made; notes below a table say what is otherwise."""
    from rich.text import Text

    from rrmctl.planning.manifest import nearest
    from rrmctl.reports.render import console_for

    known = kinds()
    if table not in (None, *known):
        raise UserError(f'there is no table "{table}"{nearest(str(table), known)}', f"there are: {', '.join(known)}")
    console = console_for()
    for title, sentences in explained(table).items():
        console.print(Text(title, style="bold"))
        console.print(*map(Text, sentences), "", sep="\n")
