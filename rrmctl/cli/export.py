"""`rrmctl export`: the store's content in the forms of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.report import OneNameArgument, into
from rrmctl.cli.screen import tell
from rrmctl.export.formats import formats
from rrmctl.reports.plugins import choose

#: Every format with the first line of its help; brackets are markup there.
_FORMATS = " ".join(f"{name}: {entry.help.splitlines()[0]}" for name, entry in formats().items()).replace("[", r"\[")


def export(
    name: OneNameArgument,
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help=_FORMATS)],
    output: Annotated[Path, into("DIR", "Folder for the files; made where it is missing.")],
    results: ResultsOption = DEFAULT_RESULTS,
    profile: Annotated[str | None, typer.Option("--profile", help="Only runs at this scale. Default: all.")] = None,
) -> None:
    """Write every evaluation of an experiment, with all labels, for other programs.

    Runs under way and failed ones are there as far as they came, marked with
    their state. Exporting again replaces what was exported: nothing doubles.
    """
    from rrmctl.export.bundle import read

    form = choose(formats(), to, "format")
    bundle = read(results, name, profile)
    if not bundle.begun:
        tell(f"note: none of the {len(bundle.runs)} planned runs has an evaluation yet", err=True)
    written = form.load().write(bundle, output)
    tell(f"{output}: {len(bundle.begun)} of {len(bundle.runs)} planned runs, {len(written)} files")
