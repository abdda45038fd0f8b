"""The end of `run` and `resume`: what is there, what is not, what to do next; and the commands that make runs again."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import typer

from rrm.errors import RrmError
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl, run_commands
from rrmctl.errors import Exit, UserError, room_error

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job, SweepRecord


def finish(
    layout: Layout, code: Exit, sweeps: Sequence[SweepRecord], *, damaged: bool = False, closing: str | None = None
) -> None:
    """Write the curves' aggregates, say how it ended and what to do next, and leave with the exit code.

    The runs are what counts: what goes wrong here is said in a line, and changes no exit code.

    Args:
        code: as the pool ended.
        sweeps: what the command was about; of each, the jobs it was about.
        damaged: a sweep the command was about could not be read, so that nobody knows whether all is done.
        closing: of the manifest, said where all is done.
    """
    from rrmctl.store.status import statuses

    command = partial(rrmctl, results=layout.root)
    names = list(dict.fromkeys(sweep.experiment for sweep in sweeps))
    states = {
        status.state for status in statuses(layout, (job for sweep in sweeps for job in sweep.everything)).values()
    }
    lost: list[tuple[str, str]] = []
    if code is not Exit.INTERRUPTED and "done" in states:
        _afterwards("not every curve was looked at", command("resume"), lambda: lost.extend(_lost(layout, sweeps)))
        for name in (name for name in names if name not in dict(lost)):
            _afterwards(
                f"aggregates/{name}.parquet was not written", command("resume", name), partial(_aggregate, layout, name)
            )
    for _, line in lost:
        tell(line)
    if code is Exit.DONE and (lost or damaged or "failed" in states):
        code = Exit.FAILED
    only = names if len(names) == 1 else ()
    match code:
        case Exit.DONE:
            tell("All done. Next:")
            for name in names:
                tell(f"  {command('report', 'iqm', name)}\n  {command('plot', name)}")
            if closing:
                tell(f"\n{closing}\n")
        case Exit.FAILED if "failed" in states:
            tell(f"Some runs failed. Why: {command('status', *only, '--failed')}")
            tell(f"Try them again: {command('resume', *only, '--retry-failed')}")
        case Exit.FAILED:
            tell("Not all is there; see above.")
        case _:
            tell(f"Not complete; this goes on where it stopped: {command('resume', *only)}")
    raise typer.Exit(code)


def _afterwards(undone: str, later: str, do: Callable[[], None]) -> None:
    """Do what may fail for any reason, and say then what is left undone and which command does it later."""
    try:
        do()
    except Exception as error:
        what = room_error(error) or error
        words = str(what) if isinstance(what, UserError | RrmError) else f"{type(what).__name__}: {what}"
        tell(f"note: {undone}: {words}; later: {later}", err=True)


def _lost(layout: Layout, sweeps: Iterable[SweepRecord]) -> Iterator[tuple[str, str]]:
    """The experiment, and a line for each run that is done and whose curve is not all there."""
    from rrmctl.store.curve import lost_rows
    from rrmctl.store.status import run_status

    jobs = {job.id: (sweep, job) for sweep in sweeps for job in sweep.jobs}
    for sweep, job in jobs.values():
        folder = layout.run(job.id)
        status = run_status(folder)
        if status.state == "done" and (problem := lost_rows(folder, status)) is not None:
            again = f"Bring the file back, or train it again: {rerun_command(layout, sweep, job)}"
            yield sweep.experiment, f"{job.label} is done, but {problem}. {again}"


def _aggregate(layout: Layout, name: str) -> None:
    """Write an experiment's `aggregates/NAME.parquet`."""
    from rrmctl.reports.iqm_curves import write_curves
    from rrmctl.reports.select import read_sections

    write_curves(layout, read_sections(layout.root, name))


def rerun_command(layout: Layout, sweep: SweepRecord, job: Job) -> str:
    """The command that trains this run again, and no other."""
    wanted = (job.task, job.method, job.seed)
    alone = sum((other.task, other.method, other.seed) == wanted for other in sweep.jobs) == 1
    (command,) = _commands(layout, sweep, [job], ["--force"] if alone else [])
    # No option tells runs apart that differ in teacher or feedback alone: the one that is gone is the one that runs.
    return command if alone else f"rm -r {shlex.quote(str(layout.run(job.id).path))} && {command}"


def unconfigured(layout: Layout, jobs: Iterable[Job]) -> set[str]:
    """Of these runs those whose configuration is gone, and those that need them: nothing but `run` makes them."""
    left = {job.id: job for job in jobs}
    gone = {run for run in left if not layout.run(run).config.exists()}
    while needing := {run for run, job in left.items() if run not in gone and gone.intersection(job.requires)}:
        gone |= needing
    return gone


def remaking_commands(
    layout: Layout, sweeps: Iterable[SweepRecord], runs: set[str], states: Mapping[str, Status]
) -> Iterator[str]:
    """The commands that write the configurations of these runs anew and run them."""
    for sweep in sweeps:
        jobs = [job for job in sweep.jobs if job.id in runs]
        failed = any(states[job.id].state in ("failed", "blocked") for job in jobs)
        yield from _commands(layout, sweep, jobs, ["--retry-failed"] if failed else [])


def _commands(layout: Layout, sweep: SweepRecord, jobs: Sequence[Job], options: Sequence[str]) -> list[str]:
    from rrmctl.store.provenance import asked_by

    asked = [asked_by(layout.run(job.id)) for job in sweep.jobs]
    asked.append([sweep.experiment, *(word for prior in sweep.priors for word in ("--prior", prior))])
    wanted = [(job.task, job.method, job.seed) for job in jobs]
    return run_commands(
        sweep.experiment, sweep.profile, sweep.overrides, wanted, asked=asked, options=options, results=layout.root
    )
