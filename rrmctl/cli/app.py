"""Assembly of the command line: the commands, and how errors become one message and an exit code."""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import rrm
from rrm.errors import RrmError
from rrm.process import environment
from rrmctl.cli import clean, demos, explain, export, inspect, page, prior, report, run, show, state
from rrmctl.errors import Exit, UserError
from rrmctl.terminal import console

#: Conditions of the machine rather than bugs of the program.
_MACHINE = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT}

#: Names that no file can have.
_NAMES = {errno.ENAMETOOLONG, errno.ELOOP}


#: Options that name a file or folder to be written to, or read.
_PLACES = {"--results", "--experiments", "-o", "--output", "--into", "--prompt"}


class _Commands(TyperGroup):
    """The group of all commands; what goes wrong for a reason the user can act on is said in one message."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for option, value in itertools.pairwise(part for word in args for part in word.split("=", 1)):
            if option in _PLACES and value == "":  # as a path it would be the folder here
                _say(f"{option} is empty", "is a variable unset? . is the folder here")
                raise typer.Exit(Exit.USAGE)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:  # the context is click's, or typer's copy of it, as its version has it
        try:
            _stand_somewhere()
            return super().invoke(ctx)
        except UserError as error:
            _say(str(error), error.hint)
            raise typer.Exit(error.code) from None
        except RrmError as error:
            _say(str(error), None)
        except OSError as error:
            if error.errno not in _MACHINE | _NAMES:
                raise
            hint = "free space or choose another --results DIR" if error.errno in _MACHINE else None
            _say(f"{error.filename or 'the file system'}: {error.strerror}", hint)
        except KeyboardInterrupt:
            raise typer.Exit(Exit.INTERRUPTED) from None
        raise typer.Exit(Exit.USAGE)


def _stand_somewhere() -> None:
    """Nothing can be named from a folder that was removed."""
    try:
        Path.cwd()
    except FileNotFoundError:
        raise UserError("the folder this command runs in is gone", "change into one that is there") from None


def _say(message: str, hint: str | None) -> None:
    """Print to standard error: in colour where somebody looks at a terminal that wants it, plain text elsewhere."""
    from rich.text import Text

    error = console(stderr=True, highlight=False, soft_wrap=True)
    with contextlib.suppress(OSError):  # the exit code still tells
        error.print(Text.assemble(("error: ", "bold red"), message))
        if hint:
            error.print(Text.assemble(("hint: ", "bold cyan"), hint))


app = typer.Typer(
    name="rrmctl",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=(
        "A first hour: [bold]rrmctl doctor[/] · [bold]rrmctl list[/] · [bold]rrmctl run quickstart[/] · "
        "[bold]rrmctl report iqm quickstart[/]. Exit codes: 0 all done, 1 a job failed, 2 bad input, "
        "75 stopped and resumable, 130 interrupted."
    ),
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rrmctl {rrm.__version__}")
        raise typer.Exit


@app.callback()
def rrmctl(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Plan, run, resume and report experiments in preference-based reinforcement learning.

    An experiment is a TOML file: tasks, methods, teachers and feedback budgets, crossed with seeds.
    Running one again continues it: only what is missing runs.
    """


_COMMANDS = (
    *(inspect.list_, inspect.plan, run.run, state.status, run.resume, show.show),
    *(report.plot, export.export, clean.clean, inspect.doctor),
)
for _command in _COMMANDS:
    app.command(_command.__name__.rstrip("_"))(_command)  # list_ is the command `list`
report.report_app.command("html")(page.html)
report.report_app.command("explain")(explain.explain)
app.add_typer(report.report_app, name="report")
app.add_typer(prior.prior_app, name="prior")
app.add_typer(demos.demos_app, name="demos")


def main() -> None:
    """The `rrmctl` program."""
    _settle()
    try:
        app()
    finally:  # how it ended is decided: a request to stop while Python winds up must not change the exit code
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)


def _settle() -> None:
    """Drop what of the user's environment is not heeded; output is UTF-8 whatever the locale, and may be closed."""
    heeded = environment()
    os.environ.clear()
    os.environ.update(heeded)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name) or Path(os.devnull).open("w")  # noqa: SIM115  (for as long as the process lives)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")  # names can hold what no encoding has
        setattr(sys, name, stream)
