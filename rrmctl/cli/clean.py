"""`rrmctl clean`: removes runs that nothing asks for any more."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.progress import runs
from rrmctl.labels import Label

if TYPE_CHECKING:
    from rrmctl.store.layout import RunFolder


def clean(
    results: ResultsOption = DEFAULT_RESULTS,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove them. Without it they are listed.")] = False,
) -> None:
    """Remove runs that no sweep asks for any more; without --yes only list them.

    A run is left over when settings, a file of yours or the program changed and the experiment was run again, or when
    its sweep's record was removed. Runs under way stay.
    """
    from rrmctl.store.reader import open_results
    from rrmctl.store.unused import remove, unused

    layout = open_results(results)
    sizes = {}
    for run in unused(layout):
        files = (path for path in layout.run(run).path.rglob("*") if path.is_file())
        sizes[run] = sum(path.lstat().st_size for path in files) / 1e6
        typer.echo(f"{run}  {sizes[run]:8.1f} MB  {_described(layout.run(run))}")
    if not yes:
        waiting = f"{runs(len(sizes))}, {sum(sizes.values()):.1f} MB. Nothing was removed; --yes removes them."
        typer.echo(waiting if sizes else "Every run is asked for by a sweep.")
        return
    gone = remove(layout, sizes)
    for run in set(sizes) - set(gone):
        typer.echo(f"{run} is in use and stays")
    typer.echo(f"{runs(len(gone))}, {sum(sizes[run] for run in gone):.1f} MB: removed.")


def _described(folder: RunFolder) -> str:
    """What its configuration says it is, and where it stands."""
    from rrmctl.errors import UserError
    from rrmctl.store.reader import read_config, run_status

    try:
        config = read_config(folder)
    except UserError as error:
        return str(error)
    label = Label(config["task"], config["method"]).seeded(config["seed"])
    return f"{config['profile']} {label}: {run_status(folder).state}"
