"""`rrmctl clean`: removes runs that nothing asks for any more."""

from __future__ import annotations

from pathlib import Path
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
    from rrmctl.store.layout import open_results
    from rrmctl.store.sweeps import remove_unused, unused_runs

    layout = open_results(results)
    found = {run: _size(layout.run(run).path) for run in unused_runs(layout)}
    for run, size in found.items():
        typer.echo(f"{run}  {size / 1e6:8.1f} MB  {_described(layout.run(run))}")
    gone = remove_unused(layout, found) if yes else []
    for run in set(found) - set(gone) if yes else ():
        typer.echo(f"{run} is in use and stays")
    told = f"{runs(len(gone))}, {sum(found[run] for run in gone) / 1e6:.1f} MB: removed."
    waiting = f"{runs(len(found))}, {sum(found.values()) / 1e6:.1f} MB. Nothing was removed; --yes removes them."
    typer.echo(told if yes else waiting if found else "Every run is asked for by a sweep.")


def _described(folder: RunFolder) -> str:
    """What its configuration says it is, and where it stands."""
    from rrmctl.errors import UserError
    from rrmctl.store.provenance import read_config
    from rrmctl.store.status import run_status

    try:
        config = read_config(folder)
    except UserError as error:
        return str(error)
    label = Label(config["task"], config["method"]).seeded(config["seed"])
    return f"{config['profile']} {label}: {run_status(folder).state}"


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file())
