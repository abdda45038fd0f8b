"""Assembly of the command line: the commands, and how errors become one message and an exit code."""

from __future__ import annotations

import errno
import itertools
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import rrm
from rrm.environ import environment
from rrm.errors import RrmError
from rrmctl.cli import demos, deploy, label, labels, plan, prior, report, run, show, status, stop
from rrmctl.errors import Exit, UserError, room_error
from rrmctl.terminal import UndeliveredError, attend, console

#: Conditions of the machine rather than bugs of the program; and of names that no file can have.
_MACHINE = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT}
_NAMES = {errno.ENAMETOOLONG, errno.ELOOP}

#: Options that name a file or folder to be written to, or read.
_PLACES = {"--results", "--experiments", "-o", "--output", "--into", "--prompt", "--frames", "--film"}

#: For what the libraries here do: a thread of each is enough, and none sets memory aside.
_MODEST = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "ARROW_IO_THREADS"), "1") | {
    "ARROW_DEFAULT_MEMORY_POOL": "system"
}


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
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Exit(Exit.INTERRUPTED) from None
        except typer.Abort:  # the end of standard input, where a question was asked
            raise typer.Exit(Exit.INCOMPLETE) from None
        except Exception as error:
            match error:
                case UserError():
                    message = error
                case RrmError():
                    message = UserError(str(error))
                case OSError(errno=number) if number in _MACHINE | _NAMES:
                    hint = "free space or choose another --results DIR" if number in _MACHINE else None
                    message = UserError(f"{error.filename or 'the file system'}: {error.strerror}", hint)
                case _ if (room := room_error(error)) is not None:
                    message = room
                case _:
                    raise
            _say(str(message), message.hint)
            raise typer.Exit(message.code) from None


def _say(message: str, hint: str | None) -> None:
    """Print to standard error: in colour where somebody looks at a terminal that wants it, plain text elsewhere."""
    from rich.text import Text

    error = console(stderr=True, soft_wrap=True)
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
def program(
    _wanted: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Plan, run, resume and report experiments in preference-based reinforcement learning.

    An experiment is a TOML file: tasks, methods, teachers and feedback budgets, crossed with seeds.
    Running one again continues it: only what is missing runs.
    """
    try:
        Path.cwd()
    except FileNotFoundError:  # nothing can be named from a folder that was removed
        raise UserError("the folder this command runs in is gone", "change into one that is there") from None


app.command("list")(plan.list_)
for _command in (
    *(plan.plan, run.run, label.label, status.status, stop.stop, run.resume, show.show),
    *(report.plot, report.export, status.clean, plan.doctor),
):
    app.command()(_command)
app.add_typer(report.report_app, name="report")
app.add_typer(prior.prior_app, name="prior")
app.add_typer(demos.demos_app, name="demos")
app.add_typer(labels.labels_app, name="labels")
app.add_typer(deploy.deploy_app, name="deploy")


def main() -> None:
    """The `rrmctl` program."""
    attend(telling=True)
    heeded = _MODEST | environment()
    os.environ.clear()
    os.environ.update(heeded)
    try:
        app()
    except UndeliveredError as loss:
        if loss.reason.errno == errno.EPIPE:  # whoever reads has what it wanted
            sys.exit(Exit.DONE)
        _say(f"standard output: {loss.reason.strerror}", "not all was printed; send it somewhere else")
        sys.exit(Exit.USAGE)
    finally:  # how it ended is decided: a request to stop while Python winds up must not change the exit code
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)
