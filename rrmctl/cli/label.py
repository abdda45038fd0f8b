"""`rrmctl label`: puts the questions of a study before people."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rrm.environ import environment
from rrmctl.cli import options
from rrmctl.cli.screen import tell
from rrmctl.cli.stop_signals import resumable
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout

#: So that a page finds the server again that was started anew.
_PORT = 8474

_EVERYWHERE = ("", "0.0.0.0", "::")  # noqa: S104 (refused)


@resumable()
def label(
    name: options.ExperimentArgument,
    results: options.ResultsOption = options.DEFAULT_RESULTS,
    annotator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="A,B",
            help="Who answers, a link each. Names stand in the data. Default: person-1.",
        ),
    ] = None,
    assign: Annotated[
        Literal["run", "query"],
        typer.Option(
            help="run: one person answers all of a run, as in the paper; query: anybody answers anything.",
        ),
    ] = "run",
    practice: Annotated[bool, typer.Option(help="A few plain pairs first, with what would have been right.")] = True,
    hint: Annotated[bool, typer.Option(help="Show the true returns of both clips, for when they look alike.")] = True,
    shared: Annotated[
        int, typer.Option(min=0, max=100, metavar="N", help="Pairs that everybody is asked first; they train nothing.")
    ] = 0,
    repeat: Annotated[
        float,
        typer.Option(
            min=0,
            max=50,
            metavar="PERCENT",
            help="So many pairs again, sides changed, of each person's own.",
        ),
    ] = 0.0,
    grace: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="SECONDS",
            help="For so long the last answer of a session can be undone before it counts.",
        ),
    ] = 30.0,
    host: Annotated[
        str,
        typer.Option(
            help="Address of this machine to serve at. Any but the default is open to its network, unencrypted.",
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes any that is free.")] = _PORT,
    skip_unshown: Annotated[
        bool, typer.Option("--skip-unshown", help="Count pairs that cannot be shown here as skipped.")
    ] = False,
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the first link in a browser here.")] = False,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Put the questions of a study before people, in their browsers, until its runs are done.

    `rrmctl run NAME` trains meanwhile, from another terminal, or starts both with --label: a run that waits goes on
    once the last answer of its session can no longer be undone. Every answer is on the disk before the next question
    shows. Ctrl-C loses none; the same command goes on, and so do pages that are open.

    A link opens one page, once; a new one is printed as soon as it was used. From other machines, prefer
    `ssh -L 8474:127.0.0.1:8474 THIS_MACHINE` to --host.

    Examples:

      rrmctl label human-study --open

      rrmctl label human-study --annotator ann,ben,cleo --shared 20 --repeat 5
    """  # fmt: skip
    from rrmctl.labelling.office import Office
    from rrmctl.labelling.question import Rules
    from rrmctl.labelling.serving import LOOPBACK, listen, serve
    from rrmctl.labelling.study import Study
    from rrmctl.store.files import try_lock
    from rrmctl.store.layout import open_results

    people = _people(annotator)
    if host in _EVERYWHERE:
        raise UserError(f"--host {host!r} is every address at once", "name the one by which people reach this machine")
    rules = Rules(people=people, assign=assign, grace_s=grace, repeat=repeat / 100, hint=hint)
    while True:
        try:
            layout = open_results(results)
            study = Study(layout, Path(name).stem)
            break
        except UserError:
            if not attached or _parent_left():
                raise
            time.sleep(0.5)  # the command beside has not written it down yet
    if (lock := try_lock(layout.labels_lock)) is None:
        raise UserError(
            f"another `rrmctl label NAME` serves {layout.root} already", "its pages show the questions of all"
        )
    sock = listen(host, port)
    try:
        address = f"http://{host}:{sock.getsockname()[1]}"
        office = Office(
            study, rules, practice=practice, shared=shared, skip_unshown=skip_unshown, say=tell, address=address
        )
        if host not in LOOPBACK:
            tell(f"note: {host} is open to its network, and what goes over it is not encrypted; ssh -L is better")
        for person in people:
            tell(f"{person}: {office.link(person)}")
        if open_ and (sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)):
            webbrowser.open(office.link(people[0]))
        serve(office, sock, host, _parent_left if attached else lambda: False)
    finally:
        sock.close()
        os.close(lock)
    if office.over:
        tell(f"{name}: every run has ended; {len(office.desk.rows):,} answers are stored")


def _people(annotator: list[str] | None) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(options.split_names(annotator) or ["person-1"]))
    for person in names:
        if not person.isprintable() or len(person) > 64:
            raise UserError(
                f"{person!r} is no name for a table", "--annotator ann,ben: at most 64 printable characters"
            )
    return names


def _parent_left() -> bool:
    """Whether whoever started this server closed its end of the pipe, or died."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


@contextlib.contextmanager
def labelling(name: str, layout: Layout) -> Iterator[None]:
    """A server of the study beside a command that runs it, with the first link opened in a browser."""
    command = [sys.executable, "-m", "rrmctl", "label", name, "--results", str(layout.root), "--open", "--attached"]
    server = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment())
    try:
        yield
    finally:
        assert server.stdin is not None
        server.stdin.close()
        server.wait()
