"""Runs that have to be made again, and the commands that make them."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rrmctl.cli.options import default_experiments
from rrmctl.commands import run_commands
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job, SweepRecord


def rerun_command(layout: Layout, sweep: SweepRecord, job: Job) -> str:
    """The command that trains this run again, and no other."""
    same = [each for each in sweep.jobs if (each.task, each.method, each.seed) == (job.task, job.method, job.seed)]
    (command,) = _commands(layout, sweep, [job], ["--force"] if len(same) == 1 else [])
    # No option tells runs apart that differ in teacher or feedback alone: the one that is gone is the one that runs.
    return command if len(same) == 1 else f"rm -r {shlex.quote(str(layout.run(job.id).path))} && {command}"


def unconfigured(layout: Layout, jobs: Iterable[Job]) -> set[str]:
    """Of these runs those whose configuration is gone, and those that need them: nothing but `run` makes them."""
    left = {job.id: job for job in jobs}
    gone = {run for run in left if not layout.run(run).config.exists()}
    while needing := {run for run, job in left.items() if run not in gone and gone.intersection(job.requires)}:
        gone |= needing
    return gone


def remaking_commands(
    layout: Layout, sweeps: Iterable[SweepRecord], runs: set[str], states: Mapping[str, Status]
) -> list[str]:
    """The commands that write the configurations of these runs anew and run them."""
    commands = []
    for sweep in sweeps:
        jobs = [job for job in sweep.jobs if job.id in runs]
        failed = any(states[job.id].state in ("failed", "blocked") for job in jobs)
        commands += _commands(layout, sweep, jobs, ["--retry-failed"] if failed else [])
    return commands


def _commands(layout: Layout, sweep: SweepRecord, jobs: Sequence[Job], options: Sequence[str]) -> list[str]:
    from rrmctl.store.provenance import asked_by

    asked = [asked_by(layout.run(job.id)) for job in sweep.jobs]
    named = sweep.priors or _priors(sweep.experiment, sorted({job.method for job in jobs}))
    asked.append([sweep.experiment, *(word for prior in named for word in ("--prior", prior))])
    wanted = [(job.task, job.method, job.seed) for job in jobs]
    return run_commands(
        sweep.experiment, sweep.profile, sweep.overrides, wanted, asked=asked, options=options, results=layout.root
    )


def _priors(experiment: str, methods: Iterable[str]) -> list[str]:
    """The priors of methods that are not in the experiment's manifest and whose names say their prior.

    Records of earlier programs do not say which --prior there was.
    """
    from rrmctl.planning.experiments import find
    from rrmctl.planning.grid import rows_of
    from rrmctl.planning.manifest import load
    from rrmctl.planning.methods import grammar

    try:
        own = {row.method for row in rows_of(load(find(experiment, default_experiments())))}
    except UserError:
        return []
    priors = {method: grammar().get(method, ("", None))[1] for method in methods if method not in own}
    return [str(prior) for method, prior in priors.items() if method == f"rrm-{prior}"]
