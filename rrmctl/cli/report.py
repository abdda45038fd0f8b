"""`rrmctl report ...`, `plot` and `export`: what the store says, as tables, figures, a page, and for other programs."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from rrm.files import place
from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.screen import tell
from rrmctl.errors import UserError
from rrmctl.export.formats import formats
from rrmctl.reports.figures import figures
from rrmctl.reports.plugins import Entry, choose
from rrmctl.reports.tables import explained, kinds
from rrmctl.terminal import spelled, stdout_console

report_app = typer.Typer(no_args_is_help=True, help="Tables from the store, with intervals and what is missing.")

Format = StrEnum("Format", ["TERMINAL", "MARKDOWN", "CSV", "LATEX", "JSON"])
Drawing = StrEnum("Drawing", ["PNG", "PDF", "SVG"])
Across = StrEnum("Across", {"COLUMN": "column", "PAGE": "page"})
IqmKindOption = StrEnum("IqmKindOption", {"RLIABLE": "rliable", "EXACT": "exact"})


def experiment(name: str) -> str:
    """Experiments are called like their manifest's file; the path of one is understood too."""
    return Path(name).stem if name.endswith(".toml") else name


def into(metavar: str, words: str) -> Any:
    """The option that says where something is written."""
    return typer.Option("-o", "--output", parser=place, metavar=metavar, help=words)


OneNameArgument = Annotated[str, typer.Argument(metavar="NAME", parser=experiment, help="An experiment of the store.")]
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
FinalOption = Annotated[
    str,
    typer.Option(
        "--final",
        metavar="last|mean-K",
        help="Score at a step: that of the evaluation there, or of each run the mean of its last K up to there.",
    ),
]
MixedOption = Annotated[
    bool,
    typer.Option(
        "--allow-mixed",
        help="Take runs together that differ in configuration version, precision, package or simulator, and say so.",
    ),
]
ReplicatesOption = Annotated[
    int, typer.Option("--replicates", min=100, help="Resampled data sets behind each interval.")
]


def _table(entry: Entry) -> Callable[..., None]:
    """The command of one kind of table."""

    def command(
        name: Annotated[
            str | None,
            typer.Argument(
                metavar="NAME", parser=experiment, help="An experiment of the store; without it, all of them."
            ),
        ] = None,
        results: ResultsOption = DEFAULT_RESULTS,
        form: Annotated[
            Format, typer.Option("--format", help="csv and json carry raw values: success as a fraction.")
        ] = Format.TERMINAL,
        output: Annotated[Path | None, into("FILE", "Write to a file instead of the terminal.")] = None,
        kind: IqmOption = IqmKindOption.RLIABLE,
        final: FinalOption = "last",
        profile: ProfileOption = None,
        replicates: ReplicatesOption = 10_000,
        allow_mixed: MixedOption = False,
        plus_minus: Annotated[
            bool,
            typer.Option("--plus-minus", help="The paper's form: one cell a value, ± half the width of its interval."),
        ] = False,
    ) -> None:
        from rrmctl.reports.render import WIDE, print_terminal, to_text
        from rrmctl.reports.select import sections_for
        from rrmctl.reports.statistics import Statistics, evaluations

        module = entry.load()
        settings = Statistics(kind=kind.value, last=evaluations(final), replicates=replicates, plus_minus=plus_minus)
        experiments = [name] if name else module.EXPERIMENTS
        apart = getattr(module, "APART", False)
        sections = sections_for(results, experiments, profile, allow_mixed=allow_mixed, apart=apart)
        reports = module.make(sections, settings)
        if output is not None:
            _write(output, to_text(reports, form.value).encode())
        elif form is Format.TERMINAL:
            print_terminal(reports, stdout_console(WIDE))
        else:
            typer.echo(spelled(to_text(reports, form.value)), nl=False)

    # Typer sees it without the options that this table has not.
    signature, lacking = inspect.signature(command, eval_str=True), {"plus_minus"} - set(entry.options)
    command.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[parameter for name, parameter in signature.parameters.items() if name not in lacking]
    )
    return command


for _entry in kinds().values():
    report_app.command(_entry.name, help=_entry.help)(_table(_entry))


@report_app.command()
def html(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", parser=experiment, help="Experiments of the store. Default: all."),
    ] = None,
    output: Annotated[Path, into("FILE", "The page; its folder is made where it is missing.")] = Path("report.html"),
    results: ResultsOption = DEFAULT_RESULTS,
    kind: IqmOption = IqmKindOption.RLIABLE,
    final: FinalOption = "last",
    profile: ProfileOption = None,
    replicates: ReplicatesOption = 10_000,
    allow_mixed: MixedOption = False,
) -> None:
    """One page with everything: tables, figures, runs, failures, cost, settings, versions, commands.

    The file needs no other and no network. Figures enlarge, tables sort, and
    it prints. Runs under way and failed ones are on it, as such.
    """
    from rrmctl.reports.page.assembly import build
    from rrmctl.reports.statistics import Statistics, evaluations

    settings = Statistics(kind=kind.value, last=evaluations(final), replicates=replicates)
    page = build(results, names or (), profile=profile, settings=settings, allow_mixed=allow_mixed).encode()
    _write(output, page)
    tell(f"{output}: {len(page) / 1e6:.1f} MB")


@report_app.command()
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


def plot(
    name: OneNameArgument,
    results: ResultsOption = DEFAULT_RESULTS,
    output: Annotated[Path | None, into("DIR", "Folder for the figures. Default: figures/ in the results.")] = None,
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
    final: FinalOption = "last",
    profile: ProfileOption = None,
    replicates: ReplicatesOption = 10_000,
    allow_mixed: MixedOption = False,
) -> None:
    """Draw the figures that suit an experiment as PNG, PDF and SVG and print their paths."""
    from rrmctl.planning.profiles import PAPER
    from rrmctl.reports.figure_layout import encode
    from rrmctl.reports.select import sections_for
    from rrmctl.reports.statistics import Statistics, evaluations

    entries = figures()
    modules = {figure: choose(entries, figure, "figure").load() for figure in wanted or entries}
    settings = Statistics(kind=kind.value, last=evaluations(final), replicates=replicates, width=width.value)
    for section in sections_for(results, [name], profile, allow_mixed=allow_mixed):
        where = f"{section.experiment}, profile {section.profile}"
        suiting = {figure: module for figure, module in modules.items() if module.suits(section)}
        if not section.contained:
            tell(f"note: {where}: no run to draw yet", err=True)
        elif wanted:
            for figure in (figure for figure in modules if figure not in suiting):
                tell(f"note: {where}: nothing to draw in the figure {figure}", err=True)
        for figure, module in suiting.items():
            try:
                drawn = module.draw(section, settings)
            except UserError as error:
                if wanted:
                    raise
                tell(f"note: {where}: the figure {figure} was not drawn: {error}", err=True)
                continue
            # The paper's own scale, the curves, single evaluations and a page's width need no mention.
            said = (
                (section.variant, PAPER),
                (figure, "curves"),
                (f"mean-{settings.last}", "mean-1"),
                (width.value, Across.PAGE),
            )
            names = [part for part, unsaid in said if part != unsaid]
            for form in forms or Drawing:
                path = (output or results / "figures") / f"{'-'.join((section.experiment, *names))}.{form}"
                _write(path, encode(drawn, form.value))
                tell(str(path))


plot.__doc__ = "\n\n".join(
    (str(plot.__doc__), *(f"{name}: {entry.help.splitlines()[0]}" for name, entry in figures().items()))
)


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


def _write(path: Path, data: bytes) -> None:
    from rrmctl.store.files import StorageError, write_bytes

    try:
        write_bytes(path, data)
    except StorageError as error:
        raise UserError(str(error), "name another place with -o") from error
