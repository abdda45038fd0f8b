"""`rrmctl report ...` and `rrmctl plot`: what the store says, as tables and figures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrmctl.reports.series import Section

report_app = typer.Typer(no_args_is_help=True, help="Tables from the store, with intervals and what is missing.")


class Format(StrEnum):
    """Forms of a table."""

    TERMINAL = "terminal"
    MARKDOWN = "markdown"
    CSV = "csv"
    LATEX = "latex"
    JSON = "json"


class Iqm(StrEnum):
    """Kinds of interquartile mean."""

    RLIABLE = "rliable"
    EXACT = "exact"


NameArgument = Annotated[
    str | None, typer.Argument(metavar="NAME", help="An experiment of the store; without it, all of them.")
]
OneNameArgument = Annotated[str, typer.Argument(metavar="NAME", help="An experiment of the store.")]
ProfileOption = Annotated[
    str | None, typer.Option("--profile", help="Only runs at this scale. Default: all, each in a table of its own.")
]
IqmOption = Annotated[
    Iqm,
    typer.Option(
        "--iqm",
        help="Interquartile mean: rliable drops whole runs at each end (of ten the middle six count); exact weighs the "
        "runs at the quartiles (four count fully, two by half).",
    ),
]


@report_app.callback()
def report() -> None:
    """Tables from the store, with intervals and what is missing."""


@report_app.command("iqm")
def iqm(
    name: NameArgument = None,
    results: ResultsOption = DEFAULT_RESULTS,
    form: Annotated[
        Format, typer.Option("--format", help="csv and json carry raw values: success as a fraction.")
    ] = Format.TERMINAL,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write to a file instead of the terminal.")
    ] = None,
    kind: IqmOption = Iqm.RLIABLE,
    profile: ProfileOption = None,
    replicates: Annotated[
        int, typer.Option("--replicates", min=100, help="Resampled data sets behind each interval.")
    ] = 10_000,
) -> None:
    """Interquartile mean of each method, with 95 % bootstrap intervals over seeds.

    Success is read at the first step at which 80 % of the seeds of any
    method but the oracle are at 100 %, else at the last step; returns at
    the last step. Profiles and overrides never share a table. The whole
    curves are written to aggregates/NAME.parquet in the results folder.
    """
    from rrmctl.reports import aggregates
    from rrmctl.reports.render import console_for, print_terminal, to_text
    from rrmctl.reports.select import of_profile, read_sections
    from rrmctl.reports.tables import Settings
    from rrmctl.reports.words import reports
    from rrmctl.store.atomic import StorageError
    from rrmctl.store.layout import Layout

    found = read_sections(results, _stem(name))
    chosen = of_profile(found, profile)
    made, curves = reports(found, Settings(kind=kind.value, replicates=replicates))
    shown = [report for section, report in zip(found, made, strict=True) if section in chosen]
    if output is not None:
        _write(output, to_text(shown, form.value).encode())
    elif form is Format.TERMINAL:
        print_terminal(shown, console_for())
    else:
        typer.echo(to_text(shown, form.value), nl=False)
    try:
        aggregates.write(Layout(results), curves)
    except StorageError as error:  # the table is what was asked for; a store one may only read still has one
        typer.echo(f"note: the curves were not kept: {error}", err=True)


def plot(
    name: OneNameArgument,
    results: ResultsOption = DEFAULT_RESULTS,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the figures. Default: figures/ in the results."),
    ] = None,
    kind: IqmOption = Iqm.RLIABLE,
    profile: ProfileOption = None,
) -> None:
    """Draw the learning curves as PNG and PDF and print their paths.

    One panel for each task: interquartile mean over seeds, band from the
    25th to the 75th percentile of the seeds, oracle dotted.
    """
    from rrmctl.reports.figures import draw, encode
    from rrmctl.reports.select import of_profile, read_sections

    for section in _with_runs(of_profile(read_sections(results, _stem(name)), profile)):
        figure = draw(section, kind=kind.value)
        for suffix in ("png", "pdf"):
            path = (output or results / "figures") / f"{_figure_name(section)}.{suffix}"
            _write(path, encode(figure, suffix))
            typer.echo(str(path))


def _with_runs(sections: Sequence[Section]) -> list[Section]:
    """Those with something to draw; the others are named on standard error."""
    for section in sections:
        if not section.contained:
            typer.echo(f"note: {section.experiment}, profile {section.profile}: no run to draw yet", err=True)
    return [section for section in sections if section.contained]


def _figure_name(section: Section) -> str:
    """Experiment and variant; the paper's own needs no mention."""
    from rrmctl.planning.profiles import PAPER

    return section.experiment if section.variant == PAPER else f"{section.experiment}-{section.variant}"


def _stem(name: str | None) -> str | None:
    """Experiments are called like their manifest's file; the path of one is understood too."""
    return Path(name).stem if name is not None and name.endswith(".toml") else name


def _write(path: Path, data: bytes) -> None:
    from rrmctl.store.atomic import StorageError, write_bytes

    try:
        write_bytes(path, data)
    except StorageError as error:
        raise UserError(str(error), "name another place with -o") from error
