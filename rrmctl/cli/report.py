"""`rrmctl report ...` and `rrmctl plot`: what the store says, as tables and figures."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError
from rrmctl.reports.figures import figures
from rrmctl.reports.plugins import choose
from rrmctl.reports.tables import kinds
from rrmctl.terminal import spelled, stdout_console

if TYPE_CHECKING:
    from rrmctl.reports.plugins import Entry
    from rrmctl.reports.series import Section

report_app = typer.Typer(no_args_is_help=True, help="Tables from the store, with intervals and what is missing.")


class Format(StrEnum):
    """Forms of a table."""

    TERMINAL = "terminal"
    MARKDOWN = "markdown"
    CSV = "csv"
    LATEX = "latex"
    JSON = "json"


class Drawing(StrEnum):
    """Forms of a figure's file; a test compares with `rrmctl.reports.figure_layout`."""

    PNG = "png"
    PDF = "pdf"
    SVG = "svg"


class Across(StrEnum):
    """Widths of a figure."""

    COLUMN = "column"
    PAGE = "page"


class IqmKindOption(StrEnum):
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
    IqmKindOption,
    typer.Option(
        "--iqm",
        help="Interquartile mean: rliable drops whole runs at each end (of ten the middle six count); exact weighs the "
        "runs at the quartiles (four count fully, two by half).",
    ),
]
MixedOption = Annotated[
    bool,
    typer.Option(
        "--allow-mixed",
        help="Take runs together that differ in configuration version, precision, package or simulator, and say so.",
    ),
]
PlusMinusOption = Annotated[
    bool,
    typer.Option("--plus-minus", help="The paper's form: one cell a value, ± half the width of its interval."),
]
ReplicatesOption = Annotated[
    int, typer.Option("--replicates", min=100, help="Resampled data sets behind each interval.")
]


@report_app.callback()
def report() -> None:
    """Tables from the store, with intervals and what is missing."""


def _table(entry: Entry) -> Callable[..., None]:
    """The command of one kind of table."""

    def command(
        name: NameArgument = None,
        results: ResultsOption = DEFAULT_RESULTS,
        form: Annotated[
            Format, typer.Option("--format", help="csv and json carry raw values: success as a fraction.")
        ] = Format.TERMINAL,
        output: Annotated[
            Path | None,
            typer.Option(
                "-o", "--output", parser=place, metavar="FILE", help="Write to a file instead of the terminal."
            ),
        ] = None,
        kind: IqmOption = IqmKindOption.RLIABLE,
        profile: ProfileOption = None,
        replicates: ReplicatesOption = 10_000,
        allow_mixed: MixedOption = False,
        plus_minus: PlusMinusOption = False,
    ) -> None:
        from rrmctl.reports.render import WIDE, print_terminal, to_text
        from rrmctl.reports.select import of_profile, read_sections
        from rrmctl.reports.statistics import Statistics

        module = entry.load()
        settings = Statistics(kind=kind.value, replicates=replicates, plus_minus=plus_minus)
        found = read_sections(results, _stem(name) or module.EXPERIMENT, allow_mixed=allow_mixed)
        shown = module.make(of_profile(found, profile), settings)
        if output is not None:
            _write(output, to_text(shown, form.value).encode())
        elif form is Format.TERMINAL:
            print_terminal(shown, stdout_console(WIDE))
        else:
            typer.echo(spelled(to_text(shown, form.value)), nl=False)

    return _without(command, {"plus_minus"} - set(entry.options))


def _without(command: Callable[..., None], options: set[str]) -> Callable[..., None]:
    """The command as typer sees it, less the options that this table has not."""
    whole = inspect.signature(command, eval_str=True)
    command.__signature__ = whole.replace(  # type: ignore[attr-defined]
        parameters=[each for name, each in whole.parameters.items() if name not in options]
    )
    return command


for _entry in kinds().values():
    report_app.command(_entry.name, help=_entry.help)(_table(_entry))


def plot(
    name: OneNameArgument,
    results: ResultsOption = DEFAULT_RESULTS,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            parser=place,
            metavar="DIR",
            help="Folder for the figures. Default: figures/ in the results.",
        ),
    ] = None,
    wanted: Annotated[
        list[str] | None,
        typer.Option("--figure", metavar="FIGURE", help=f"Only this one, may be repeated: {', '.join(figures())}."),
    ] = None,
    forms: Annotated[
        list[Drawing] | None,
        typer.Option("--format", help="Only this form of file, may be repeated. Default: all three."),
    ] = None,
    width: Annotated[
        Across,
        typer.Option("--width", help="column: 3.3 inches, one column of a paper; page: as it needs, at most 7 inches."),
    ] = Across.PAGE,
    kind: IqmOption = IqmKindOption.RLIABLE,
    profile: ProfileOption = None,
    replicates: ReplicatesOption = 10_000,
    allow_mixed: MixedOption = False,
) -> None:
    """Draw the figures that suit an experiment as PNG, PDF and SVG and print their paths."""
    from rrmctl.reports.figure_layout import encode
    from rrmctl.reports.select import of_profile, read_sections
    from rrmctl.reports.statistics import Statistics

    known = figures()
    drawn = {figure: choose(known, figure, "figure").load() for figure in wanted or known}
    settings = Statistics(kind=kind.value, replicates=replicates, width=width.value)
    found = read_sections(results, _stem(name), allow_mixed=allow_mixed)
    for section in _with_runs(of_profile(found, profile)):
        where = f"{section.experiment}, profile {section.profile}"
        for figure, module in drawn.items():
            if not module.suits(section):
                if wanted:
                    tell(f"note: {where}: nothing to draw in the figure {figure}", err=True)
                continue
            try:
                made = module.draw(section, settings)
            except UserError as error:
                if wanted:
                    raise
                tell(f"note: {where}: the figure {figure} was not drawn: {error}", err=True)
                continue
            for suffix in forms or Drawing:
                path = (output or results / "figures") / f"{_figure_name(section, figure, width)}.{suffix}"
                _write(path, encode(made, suffix.value))
                tell(str(path))


plot.__doc__ = "\n\n".join(
    (str(plot.__doc__), *(f"{name}: {entry.help.splitlines()[0]}" for name, entry in figures().items()))
)


def _with_runs(sections: Sequence[Section]) -> list[Section]:
    """Those with something to draw; the others are named on standard error."""
    for section in sections:
        if not section.contained:
            tell(f"note: {section.experiment}, profile {section.profile}: no run to draw yet", err=True)
    return [section for section in sections if section.contained]


def _figure_name(section: Section, figure: str, width: Across) -> str:
    """Experiment, variant, figure and width; the paper's own scale, the curves and a page's width need no mention."""
    from rrmctl.planning.profiles import PAPER

    variant = () if section.variant == PAPER else (section.variant,)
    rest = (*(() if figure == "curves" else (figure,)), *(() if width is Across.PAGE else (width.value,)))
    return "-".join((section.experiment, *variant, *rest))


def _stem(name: str | None) -> str | None:
    """Experiments are called like their manifest's file; the path of one is understood too."""
    return Path(name).stem if name is not None and name.endswith(".toml") else name


def _write(path: Path, data: bytes) -> None:
    from rrmctl.store.files import StorageError, write_bytes

    try:
        write_bytes(path, data)
    except StorageError as error:
        raise UserError(str(error), "name another place with -o") from error
