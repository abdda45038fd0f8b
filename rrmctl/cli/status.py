"""`rrmctl status`: where runs stand."""

from __future__ import annotations

import json
import socket
import sys
import time
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.progress import OVER, STATES, Group, errors, group_by_row, group_by_sweep, runs
from rrmctl.cli.rerun import remaking_commands, unconfigured
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rich.console import RenderableType

    from rrmctl.store.snapshot import Snapshot

#: Time between two looks of `status --watch`, seconds.
_WATCH_S = 2.0

_COLOURS = {
    "done": "green",
    "running": "cyan",
    "interrupted": "yellow",
    "waiting": "yellow",
    "failed": "red",
    "blocked": "red",
    "unreadable": "bold red",
}


def status(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Only this experiment, in more detail. Default: all.")
    ] = None,
    results: ResultsOption = DEFAULT_RESULTS,
    watch: Annotated[bool, typer.Option("--watch", help="Look again every two seconds until nothing is left.")] = False,
    failed: Annotated[bool, typer.Option("--failed", help="Failed runs, grouped by what went wrong.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, one line a look, for programs.")] = False,
) -> None:
    """Tell how far every sweep in the results folder is. Reads only, at any time, while anything runs.

    A run is "interrupted" when its process stopped or died before its end; `rrmctl resume` goes on with it.
    """
    from rrmctl.store.snapshot import Snapshot

    def look() -> _View:
        return _View(Snapshot(results, name, lenient=True), detailed=name is not None, failed=failed)

    view = look()
    note_damage(view.damage)
    if not watch:
        typer.echo(json.dumps(view.as_json())) if as_json else stdout_console().print(view.table())
        return
    try:
        _watch(view, look, as_json=as_json)
    except KeyboardInterrupt:  # how one leaves it
        return


def _watch(view: _View, look: Any, *, as_json: bool) -> None:
    from rich.live import Live

    console = stdout_console()
    if as_json or not sys.stdout.isatty():
        said = None
        while True:
            told = json.dumps(view.as_json()) if as_json else view.line()
            if told != said:
                tell(told)
                said = told
            if not view.has_work:
                return
            time.sleep(_WATCH_S)
            view = look()
    with Live(view.table(), console=console, auto_refresh=False) as live:
        while view.has_work:
            time.sleep(_WATCH_S)
            view = look()
            live.update(view.table(), refresh=True)


class _View:
    """One look at the store, ready to be shown.

    Args:
        detailed: one line per row of the grid instead of one per sweep, and the runs under way.
        failed: the failures instead.
    """

    def __init__(self, store: Snapshot, *, detailed: bool, failed: bool) -> None:
        self._layout, self._sweeps, self._states = store.layout, store.sweeps, store.states
        self.damage = store.damage
        self._failed = failed
        sweeps, states = store.sweeps, store.states
        self.groups = group_by_row(sweeps, states) if detailed else group_by_sweep(sweeps, states)
        jobs = {job.id: job for sweep in sweeps for job in sweep.everything}
        self.total = Group("all", list(jobs.values()), states)

    @property
    def has_work(self) -> bool:
        """Whether any run is neither done nor failed."""
        return self.total.open > 0

    def line(self) -> str:
        """The totals in words."""
        counts = ", ".join(f"{self.total.counts[state]} {state}" for state in STATES if self.total.counts[state])
        left = f", about {self.total.left} left" if self.total.left else ""
        return f"{counts} of {runs(len(self.total.jobs))}{left}"

    def table(self) -> RenderableType:
        """For people."""
        from rich.console import Group as Stack
        from rich.table import Table

        if not self._sweeps:
            begin = self._command("run", "quickstart")
            return f"{self._layout.root} holds no sweep yet. Begin one: {begin}"
        if self._failed:
            return self._failures()
        table = Table(box=None, pad_edge=False)
        shown = [state for state in STATES if self.total.counts[state] or state == "done"]
        table.add_column(self.groups[0].heading)
        for column in (*shown, "of", "left"):
            table.add_column(column, justify="right", style=_COLOURS.get(column))
        for group in self.groups:
            counts = (str(group.counts[state] or "-") for state in shown)
            table.add_row(group.name, *counts, str(len(group.jobs)), group.left)
        return Stack(table, "", self.line(), *self._hints())

    def _hints(self) -> list[str]:
        hints = []
        if self.total.counts["failed"] or self.total.counts["unreadable"]:
            hints.append(f"Why runs failed: {self._command('status', '--failed')}")
        waited = Counter(str(status.error) for status in self._states.values() if status.state == "waiting")
        hints += [f"{runs(count)} waiting for {what}" for what, count in waited.items()]
        hosts = {status.host for status in self._states.values() if status.state == "running" and status.host}
        if elsewhere := sorted(hosts - {socket.gethostname()}):
            after = f"should one be gone, this takes its runs over after 30 s of silence: {self._command('resume')}"
            hints.append(f"Running on {', '.join(elsewhere)}; {after}")
        jobs = [job for job in self.total.jobs if self._states[job.id].state not in OVER]
        gone = unconfigured(self._layout, jobs)
        if not self.total.counts["running"] and len(jobs) > len(gone):
            hints.append(f"Nothing is running; this goes on: {self._command('resume')}")
        for command in remaking_commands(self._layout, self._sweeps, gone, self._states):
            hints.append(f"Configurations are missing; this makes them, and the runs: {command}")
        return hints

    def _command(self, *words: str) -> str:
        return rrmctl(*words, results=self._layout.root)

    def _failures(self) -> RenderableType:
        from rich.text import Text

        lines = Text()
        found = errors(self.total.jobs, self._states)
        if not found:
            return Text("No run failed.")
        for message, jobs in found.items():
            lines.append(f"{runs(len(jobs))}: {message}\n", style="red")
            for job in jobs:
                lines.append(f"  {job.id}  {job.label}, attempt {self._states[job.id].attempt}\n")
        last = self._layout.run(jobs[-1].id)
        lines.append(f"The end of a log: {self._command('show', last.id)}; all of it: {last.log}")
        return lines

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "runs": len(self.total.jobs), **{state: self.total.counts[state] for state in STATES},
            "core_seconds_left": self.total.seconds_left, "groups": [group.as_json() for group in self.groups],
            "errors": {
                message: [job.id for job in jobs] for message, jobs in errors(self.total.jobs, self._states).items()
            },
        }  # fmt: skip


def note_damage(damage: Iterable[UserError]) -> None:
    """One line on standard error for each file that a command can go on without."""
    for error in damage:
        tell(f"note: {error}; {error.hint}", err=True)
