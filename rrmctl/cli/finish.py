"""The end of `run` and `resume`: what is there, what is not, what to do next, and the exit code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import typer

from rrmctl.cli.options import DEFAULT_RESULTS
from rrmctl.cli.screen import tell
from rrmctl.cli.state import rerun_command
from rrmctl.errors import Exit, UserError

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
    from rrmctl.store.sweeps import JobRecord, SweepRecord


def finish(
    layout: Layout, code: Exit, sweeps: Sequence[SweepRecord], *, damaged: bool = False, closing: str | None = None
) -> None:
    """Write the curves' aggregates, say how it ended and what to do next, and leave with the exit code.

    Args:
        code: as the pool ended.
        sweeps: what the command was about; of each, the jobs it was about.
        damaged: a sweep the command was about could not be read, so that nobody knows whether all is done.
        closing: of the manifest, said where all is done.
    """
    from rrmctl.store.reader import statuses

    names = list(dict.fromkeys(sweep.experiment for sweep in sweeps))
    states = statuses(layout, (job for sweep in sweeps for job in sweep.everything))
    found = {status.state for status in states.values()}
    if code is not Exit.INTERRUPTED and "done" in found:
        _aggregate(layout, names)
    lost = list(_lost(layout, sweeps)) if code is not Exit.INTERRUPTED else []
    for line in lost:
        tell(line)
    if code is Exit.DONE and (lost or damaged or "failed" in found):
        code = Exit.FAILED
    _advise(layout, code, names, failed="failed" in found)
    if closing and code is Exit.DONE:
        tell(f"\n{closing}\n")
    raise typer.Exit(code)


def _advise(layout: Layout, code: Exit, names: Sequence[str], *, failed: bool) -> None:
    here = "" if layout.root == DEFAULT_RESULTS else f" --results {layout.root}"
    name = f" {names[0]}" if len(names) == 1 else ""
    match code:
        case Exit.DONE:
            tell("All done. Next:")
            for each in names:
                tell(f"  rrmctl report iqm {each}{here}")
                tell(f"  rrmctl plot {each}{here}")
        case Exit.FAILED if failed:
            tell(f"Some runs failed: rrmctl status{name} --failed{here}; --retry-failed tries them again.")
        case Exit.FAILED:
            tell("Not all is there; see above.")
        case _:
            tell(f"Not complete: rrmctl resume{name}{here} goes on where it stopped.")


def _lost(layout: Layout, sweeps: Iterable[SweepRecord]) -> Iterator[str]:
    """A line for each run that is done and whose curve is not all there."""
    from rrmctl.store.reader import lost_rows, run_status

    jobs: dict[str, tuple[SweepRecord, JobRecord]] = {job.id: (sweep, job) for sweep in sweeps for job in sweep.jobs}

    def look(run: str) -> str | None:
        folder = layout.run(run)
        status = run_status(folder)
        return lost_rows(folder, status) if status.state == "done" else None

    with ThreadPoolExecutor(max_workers=8) as threads:
        for run, problem in zip(jobs, threads.map(look, jobs), strict=True):
            if problem is not None:
                sweep, job = jobs[run]
                command = rerun_command(layout, sweep, job)
                yield f"{job.label} is done, but {problem}. Bring the file back, or train it again: {command}"


def _aggregate(layout: Layout, names: Iterable[str]) -> None:
    """Write each experiment's `aggregates/NAME.parquet`. The runs are what counts: no error."""
    from rrm.errors import RrmError
    from rrmctl.reports import aggregates
    from rrmctl.reports.select import read_sections

    for name in names:
        try:
            aggregates.write(layout, read_sections(layout.root, name))
        except (UserError, RrmError) as error:
            tell(f"note: aggregates/{name}.parquet was not written: {error}", err=True)
