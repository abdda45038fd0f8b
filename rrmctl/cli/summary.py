"""The end of `run` and `resume`: what is there, what is not, what to do next; and the commands that make runs again."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import typer

from rrm.errors import RrmError
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl, run_commands
from rrmctl.errors import Exit, UserError, room_error
from rrmctl.labels import policy

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
    from rrmctl.store.snapshot import Snapshot
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job, SweepRecord


def finish(
    layout: Layout, code: Exit, sweeps: Sequence[SweepRecord], *, damaged: bool = False, closing: str | None = None,
    again: Sequence[str] = (),
) -> None:  # fmt: skip
    """Write the curves' aggregates, say how it ended and what to do next, and leave with the exit code.

    The runs are what counts: what goes wrong here is said in a line, and changes no exit code.

    Args:
        code: as the pool ended.
        sweeps: what the command was about.
        damaged: a sweep could not be read, so that nobody knows whether all is done.
        closing: of the manifest, said where all is done.
        again: options that have `resume` run things in the same way.
    """
    from rrmctl.store.status import statuses

    command = partial(rrmctl, results=layout.root)
    names = list(dict.fromkeys(sweep.experiment for sweep in sweeps))
    status_of = statuses(layout, (job for sweep in sweeps for job in sweep.everything))
    states = {status.state for status in status_of.values()}
    lost: list[tuple[str, str]] = []
    if code is not Exit.INTERRUPTED and "done" in states:
        with _afterwards("not every curve was looked at", later=command("resume")):
            lost.extend(_lost(layout, sweeps, status_of))
        for name in (name for name in names if name not in dict(lost)):
            with _afterwards(f"aggregates/{name}.parquet was not written", later=command("resume", name)):
                from rrmctl.reports.iqm_curves import write_curves
                from rrmctl.reports.select import read_sections

                write_curves(layout, read_sections(layout.root, name))
    for _, line in lost:
        tell(line)
    if code is Exit.DONE and (lost or damaged or "failed" in states):
        code = Exit.FAILED
    only = names if len(names) == 1 else ()
    again = ("resume", *only, *again)
    match code:
        case Exit.DONE:
            tell("All done. Next:")
            for name in names:
                tell(f"  {command('report', 'iqm', name)}\n  {command('plot', name)}")
            for name in dict.fromkeys(sweep.experiment for sweep in sweeps if sweep.deployments):
                tell(f"  {command('report', 'sim-to-real', name)}")
            if closing:
                tell(f"\n{closing}\n")
        case Exit.FAILED if "failed" in states:
            tell(f"Some runs failed. Why: {command('status', *only, '--failed')}")
            tell(f"Try them again: {command(*again, '--retry-failed')}")
        case Exit.FAILED:
            tell("Not all is there; see above.")
        case _:
            tell(f"Not complete; this goes on where it stopped: {command(*again)}")
    raise typer.Exit(code)


@contextlib.contextmanager
def _afterwards(undone: str, *, later: str) -> Iterator[None]:
    """Of what may fail for any reason: a line says then what is left undone, and which command does it later."""
    try:
        yield
    except Exception as error:
        what = room_error(error) or error
        words = str(what) if isinstance(what, UserError | RrmError) else f"{type(what).__name__}: {what}"
        tell(f"note: {undone}: {words}; later: {later}", err=True)


def _lost(layout: Layout, sweeps: Iterable[SweepRecord], status_of: Mapping[str, Status]) -> Iterator[tuple[str, str]]:
    """The experiment, and a line for each run that is done and whose curve is not all there."""
    from rrmctl.store.curve import lost_rows

    jobs = {job.id: (sweep, job) for sweep in sweeps for job in (*sweep.jobs, *sweep.deployments)}
    for sweep, job in jobs.values():
        status = status_of[job.id]
        if status.state == "done" and (problem := lost_rows(layout.run(job.id), status)) is not None:
            again = f"Bring the file back, or make it again: {rerun_command(layout, sweep, job)}"
            yield sweep.experiment, f"{job.label} is done, but {problem}. {again}"


def rerun_command(layout: Layout, sweep: SweepRecord, job: Job) -> str:
    """The command that makes this run again, and no other."""
    wanted = (job.task, policy(job.method), job.seed)
    alone = sum((other.task, other.method, other.seed) == wanted for other in sweep.jobs) == 1
    alone = alone and job not in sweep.deployments
    (command,) = _commands(layout, sweep, [job], ["--force"] if alone else [])
    # No option tells runs apart that differ in teacher or feedback alone, or a deployment from what it deploys: the one
    # that is gone is the one that runs.
    return command if alone else f"rm -r {shlex.quote(str(layout.run(job.id).path))} && {command}"


def unconfigured(layout: Layout, jobs: Iterable[Job]) -> set[str]:
    """Of these runs those whose configuration is gone, and those that need them: nothing but `run` makes them."""
    left = {job.id: job for job in jobs}
    gone = {run for run in left if not layout.run(run).config.exists()}
    while needing := {run for run, job in left.items() if run not in gone and gone.intersection(job.requires)}:
        gone |= needing
    return gone


def remaking_commands(store: Snapshot, runs: set[str]) -> Iterator[str]:
    """The commands that write the configurations of these runs anew and run them."""
    for sweep in store.sweeps:
        jobs = [job for job in sweep.jobs if job.id in runs]
        failed = any(store.states[job.id].state in ("failed", "blocked") for job in jobs)
        yield from _commands(store.layout, sweep, jobs, ["--retry-failed"] if failed else [])


def _commands(layout: Layout, sweep: SweepRecord, jobs: Sequence[Job], options: Sequence[str]) -> list[str]:
    from rrmctl.store.provenance import asked_by

    commands = [asked_by(layout.run(job.id)) for job in sweep.jobs]
    commands.append([sweep.experiment, *(word for prior in sweep.priors for word in ("--prior", prior))])
    wanted = [(job.task, policy(job.method), job.seed) for job in jobs]
    return run_commands(
        sweep.experiment, sweep.profile, sweep.overrides, wanted, asked=commands, options=options, results=layout.root
    )
