"""`rrmctl status`, where runs stand, and `rrmctl clean`, which removes those that nothing asks for any more."""

from __future__ import annotations

import contextlib
import json
import socket
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rrmctl.cli.options import DEFAULT_RESULTS, ResultsOption
from rrmctl.cli.progress import (
    OVER,
    STATES,
    Group,
    awaited,
    errors,
    experiments,
    group_by_row,
    group_by_sweep,
    runs,
)
from rrmctl.cli.queued import Queued, look
from rrmctl.cli.screen import tell
from rrmctl.cli.summary import remaking_commands, unconfigured
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.terminal import stdout_console

if TYPE_CHECKING:
    from rich.console import RenderableType

    from rrmctl.store.labels import OpenSession
    from rrmctl.store.snapshot import Snapshot

#: Time between two looks of `status --watch`, seconds; and where each look asks the queue of a cluster.
_WATCH_S = 2.0
_WATCH_QUEUE_S = 15.0

_COLOURS = {
    "done": "green", "running": "cyan", "interrupted": "yellow", "waiting": "yellow", "failed": "red", "blocked": "red",
    "unreadable": "bold red",
}  # fmt: skip


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

    A run is "interrupted" when its process stopped or died before its end; `rrmctl resume` goes on with it. Of job
    arrays Slurm is asked: which runs are queued and why, which run where, which are lost.
    """
    from rrmctl.store.snapshot import Snapshot

    def view_now() -> _View:
        store = Snapshot(results, name, lenient=True)
        groups = (group_by_sweep if name is None else group_by_row)(store.sweeps, store.states)
        jobs = {job.id: job for sweep in store.sweeps for job in sweep.everything}
        return _View(store, groups, Group("all", list(jobs.values()), store.states))

    view = view_now()
    note_damage(view.store.damage)
    if not watch:
        typer.echo(json.dumps(view.as_json())) if as_json else stdout_console().print(view.shown(failed=failed))
        return
    from rich.live import Live

    said = None
    at_terminal = sys.stdout.isatty() and not as_json
    live = Live(console=stdout_console(), auto_refresh=False) if at_terminal else contextlib.nullcontext()
    with contextlib.suppress(KeyboardInterrupt), live as display:  # how one leaves it
        while True:
            if display is not None:
                display.update(view.shown(failed=failed), refresh=True)
            elif (line := json.dumps(view.as_json()) if as_json else view.line()) != said:
                tell(line)
                said = line
            if not view.total.open:
                return
            time.sleep(_WATCH_QUEUE_S if view.queued else _WATCH_S)
            view = view_now()


@dataclass(frozen=True)
class _View:
    """One look at the store, ready to be shown."""

    store: Snapshot
    groups: Sequence[Group]  #: the lines of the table
    total: Group

    @cached_property
    def asked(self) -> dict[str, OpenSession]:
        """What people are asked, by the runs that wait for it."""
        from rrmctl.store.labels import waits_for

        looked = {run: waits_for(self.store.layout.run(run), status) for run, status in self.store.states.items()}
        return {run: session for run, session in looked.items() if session is not None}

    @cached_property
    def queued(self) -> Queued | None:
        """What the queue of a cluster has of it; None where nothing was ever submitted."""
        return look(self.store.layout, self.store.states) if self.store.layout.submissions() else None

    def line(self) -> str:
        """The totals in words."""
        counts = ", ".join(f"{self.total.counts[state]} {state}" for state in STATES if self.total.counts[state])
        left = f", about {self.total.left} left" if self.total.left else ""
        return f"{counts} of {runs(len(self.total.jobs))}{left}"

    def shown(self, *, failed: bool) -> RenderableType:
        """For people: the table, or the runs that failed."""
        if not self.store.sweeps:
            return f"{self.store.layout.root} holds no sweep yet. Begin one: {self._command('run', 'quickstart')}"
        if failed:
            return self._failures()
        from rich.console import Group as Stack
        from rich.table import Table

        table = Table(box=None, pad_edge=False)
        shown = [state for state in STATES if self.total.counts[state] or state == "done"]
        table.add_column(self.groups[0].heading)
        for column in (*shown, "of", "left"):
            table.add_column(column, justify="right", style=_COLOURS.get(column))
        for group in self.groups:
            counts = (str(group.counts[state] or "-") for state in shown)
            table.add_row(group.name, *counts, str(len(group.jobs)), group.left)
        return Stack(table, "", self.line(), *self._hints())

    def _hints(self) -> Iterator[str]:
        if self.total.counts["failed"] or self.total.counts["unreadable"]:
            yield f"Why runs failed: {self._command('status', '--failed')}"
        yield from awaited(self.asked.values(), experiments(self.store.sweeps), self.store.layout.root)
        others = [status for run, status in self.store.states.items() if run not in self.asked]
        for what, count in Counter(str(status.error) for status in others if status.state == "waiting").items():
            yield f"{runs(count)} waiting for {what}"
        from rrmctl.store.owner import lease_s

        queued = self.queued or Queued()
        resume = self._command("resume", *(() if self.queued is None else ("--executor", "slurm")))
        yield from queued.lines(self._command)
        known = queued.tasks.keys() | queued.lost.keys()
        running = [
            status for run, status in self.store.states.items() if status.state == "running" and run not in known
        ]
        hosts = {status.host for status in running if status.host}
        if elsewhere := sorted(hosts - {socket.gethostname()}):
            silence = f"{lease_s(self.store.layout.root):g} s of silence"
            after = f"should one be gone, this takes its runs over after {silence}: {resume}"
            yield f"Running on {', '.join(elsewhere)}; {after}"
        jobs = [job for job in self.total.jobs if self.store.states[job.id].state not in OVER]
        gone = unconfigured(self.store.layout, jobs)
        if not self.total.counts["running"] and not queued.tasks and len(jobs) > len(gone):
            yield f"Nothing is running; this goes on: {resume}"
        for command in remaking_commands(self.store, gone):
            yield f"Configurations are missing; this makes them, and the runs: {command}"

    def _command(self, *words: str) -> str:
        return rrmctl(*words, results=self.store.layout.root)

    def _failures(self) -> RenderableType:
        from rich.text import Text

        if not (failed := errors(self.total.jobs, self.store.states)):
            return Text("No run failed.")
        lines = Text()
        for message, jobs in failed.items():
            lines.append(f"{runs(len(jobs))}: {message}\n", style="red")
            for job in jobs:
                lines.append(f"  {job.id}  {job.label}, attempt {self.store.states[job.id].attempt}\n")
        last = self.store.layout.run(jobs[-1].id)
        return lines.append(f"The end of a log: {self._command('show', last.id)}; all of it: {last.log}")

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        failed = errors(self.total.jobs, self.store.states)
        return {
            "runs": len(self.total.jobs), **{state: self.total.counts[state] for state in STATES},
            "answers_missing": sum(session.missing for session in self.asked.values()),
            "core_seconds_left": self.total.seconds_left, "groups": [group.as_json() for group in self.groups],
            "errors": {message: [job.id for job in jobs] for message, jobs in failed.items()},
            "slurm": self.queued and self.queued.as_json(),
        }  # fmt: skip


def note_damage(damage: Iterable[UserError]) -> None:
    """One line on standard error for each file that a command can go on without."""
    for error in damage:
        tell(f"note: {error}; {error.hint}", err=True)


def clean(
    results: ResultsOption = DEFAULT_RESULTS,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove them. Without it they are listed.")] = False,
    labels: Annotated[bool, typer.Option("--labels", help="Also those that hold answers of people.")] = False,
) -> None:
    """Remove runs that no sweep asks for any more; without --yes only list them.

    A run is left over when settings, a file of yours or the program changed and the experiment was run again, or when
    its sweep's record was removed. Runs under way stay, and so does what people answered, unless --labels says it, too.
    """
    from rrmctl.store.layout import open_results
    from rrmctl.store.provenance import read_config
    from rrmctl.store.status import run_status
    from rrmctl.store.sweeps import remove_unused, unused_runs

    layout = open_results(results)
    sizes, kept = {}, []
    for run in unused_runs(layout):
        folder = layout.run(run)
        try:
            config = read_config(folder)
            label = Label(config["task"], config["method"]).seeded(config["seed"])
            about = f"{config['profile']} {label}: {run_status(folder).state}"
        except UserError as error:
            about = str(error)
        if folder.labels.exists() and not labels:
            kept.append(run)
            typer.echo(f"{run}  holds answers of people and stays, unless --labels is said, too  {about}")
            continue
        files = (path for path in folder.path.rglob("*") if path.is_file())
        sizes[run] = sum(path.lstat().st_size for path in files) / 1e6
        typer.echo(f"{run}  {sizes[run]:8.1f} MB  {about}")
    if not yes:
        waiting = f"{runs(len(sizes))}, {sum(sizes.values()):.1f} MB. Nothing was removed; --yes removes them."
        if sizes or not kept:
            typer.echo(waiting if sizes else "Every run is asked for by a sweep.")
        return
    gone = remove_unused(layout, sizes, labels=labels)
    for run in set(sizes) - set(gone):
        typer.echo(f"{run} is in use and stays")
    typer.echo(f"{runs(len(gone))}, {sum(sizes[run] for run in gone):.1f} MB: removed.")
