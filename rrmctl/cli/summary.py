"""The end of `run` and `resume`: what is there, what is not, what to do next, and the exit code."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import typer

from rrm.errors import RrmError
from rrmctl.cli.rerun import rerun_command
from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl
from rrmctl.errors import Exit, UserError, room_error

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
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

    names = list(dict.fromkeys(sweep.experiment for sweep in sweeps))
    states = statuses(layout, (job for sweep in sweeps for job in sweep.everything))
    found = {status.state for status in states.values()}
    lost: list[tuple[str, str]] = []
    if code is not Exit.INTERRUPTED and "done" in found:
        again = rrmctl("resume", results=layout.root)
        _afterwards("not every curve was looked at", again, lambda: lost.extend(_lost(layout, sweeps)))
        for name in (each for each in names if each not in dict(lost)):
            later = rrmctl("resume", name, results=layout.root)
            _afterwards(f"aggregates/{name}.parquet was not written", later, partial(_aggregate, layout, name))
    for _, line in lost:
        tell(line)
    if code is Exit.DONE and (lost or damaged or "failed" in found):
        code = Exit.FAILED
    _advise(layout, code, names, failed="failed" in found)
    if closing and code is Exit.DONE:
        tell(f"\n{closing}\n")
    raise typer.Exit(code)


def _afterwards(undone: str, later: str, do: Callable[[], None]) -> None:
    """Do what may fail for any reason, and say then what is left undone and which command does it later."""
    try:
        do()
    except Exception as error:
        what = room_error(error) or error
        words = str(what) if isinstance(what, UserError | RrmError) else f"{type(what).__name__}: {what}"
        tell(f"note: {undone}: {words}; later: {later}", err=True)


def _advise(layout: Layout, code: Exit, names: Sequence[str], *, failed: bool) -> None:
    command = partial(rrmctl, results=layout.root)
    name = names[:1] if len(names) == 1 else ()
    match code:
        case Exit.DONE:
            tell("All done. Next:")
            for each in names:
                tell(f"  {command('report', 'iqm', each)}")
                tell(f"  {command('plot', each)}")
        case Exit.FAILED if failed:
            tell(f"Some runs failed. Why: {command('status', *name, '--failed')}")
            tell(f"Try them again: {command('resume', *name, '--retry-failed')}")
        case Exit.FAILED:
            tell("Not all is there; see above.")
        case _:
            tell(f"Not complete; this goes on where it stopped: {command('resume', *name)}")


def _lost(layout: Layout, sweeps: Iterable[SweepRecord]) -> Iterator[tuple[str, str]]:
    """The experiment, and a line for each run that is done and whose curve is not all there."""
    from rrmctl.store.curve import lost_rows
    from rrmctl.store.status import run_status

    jobs: dict[str, tuple[SweepRecord, Job]] = {job.id: (sweep, job) for sweep in sweeps for job in sweep.jobs}

    def look(run: str) -> str | None:
        folder = layout.run(run)
        status = run_status(folder)
        return lost_rows(folder, status) if status.state == "done" else None

    for run, (sweep, job) in jobs.items():
        problem = look(run)
        if problem is not None:
            command = rerun_command(layout, sweep, job)
            told = f"{job.label} is done, but {problem}. Bring the file back, or train it again: {command}"
            yield sweep.experiment, told


def _aggregate(layout: Layout, name: str) -> None:
    """Write an experiment's `aggregates/NAME.parquet`."""
    from rrmctl.reports.iqm_curves import write_curves
    from rrmctl.reports.select import read_sections

    write_curves(layout, read_sections(layout.root, name))
