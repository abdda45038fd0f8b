"""The record of what a sweep asked for: its jobs, the runs that they are, and runs that no record asks for any more."""

from __future__ import annotations

import contextlib
import dataclasses
import graphlib
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, StrictInt, StrictStr

from rrm.files import sync_folder
from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.store.files import (
    PATIENCE_S,
    DamagedError,
    StorageError,
    locked,
    remove_leftovers,
    set_aside,
    storage_error,
)
from rrmctl.store.layout import Layout, RunFolder, never_run
from rrmctl.store.lease import Lease
from rrmctl.store.records import RunId, read_record, write_json
from rrmctl.store.schema import SCHEMA_VERSION


@dataclass(frozen=True, kw_only=True)
class Job:
    """One planned job: which run it is, and what it is called in its experiment."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    id: RunId  #: the run's identity
    cell: StrictStr  #: the identity of all seeds together
    task: StrictStr
    method: StrictStr
    teacher: StrictStr  #: `NOTHING_ASKED` where nothing is
    feedback: StrictStr  #: "50@5000/5000": queries of a session, steps between sessions, queries in all; or the same
    seed: StrictInt
    steps: StrictInt  #: of the whole run
    requires: tuple[RunId, ...] = ()  #: ids of the runs that must be done before it

    @property
    def row(self) -> Label:
        """What it is called, whatever its seed."""
        return Label(self.task, self.method, self.teacher, self.feedback)

    @property
    def place(self) -> tuple[Label, int]:
        """What it is in a report, where one run can be at a time."""
        return (self.row, self.seed)

    @property
    def label(self) -> str:
        """For people: task, method, teacher and feedback where they say something, seed."""
        return self.row.seeded(self.seed)


@dataclass(frozen=True, kw_only=True)
class SweepRecord:
    """What `run` was asked for: one variant (profile and overrides) of an experiment."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    experiment: StrictStr
    variant: StrictStr
    profile: StrictStr
    overrides: dict[str, Any] = field(default_factory=dict)
    jobs: tuple[Job, ...] = ()
    needed: tuple[Job, ...] = ()  #: runs that jobs need; nothing reports them, and some may be jobs as well
    priors: tuple[StrictStr, ...] = ()  #: of `--prior`, which added methods to those of the manifest
    deployments: tuple[Job, ...] = ()  #: of jobs' policies, once those are done; reports of deployments alone read them
    superseded: tuple[Job, ...] = ()  #: another run was asked for in their place, of other settings or files

    @property
    def everything(self) -> tuple[Job, ...]:
        """Every run, those that are only needed first, deployments last; one that several rows share is there for each
        of them.
        """
        return (*self.merely_needed, *self.jobs, *self.deployments)

    @property
    def merely_needed(self) -> tuple[Job, ...]:
        """Runs that jobs need and that are no jobs themselves."""
        others = {job.id: job for job in (*self.superseded, *self.needed)}
        wanted = required(self.jobs, others.values()) - {job.id for job in self.jobs}
        return tuple(job for run, job in others.items() if run in wanted)

    def union(self, other: SweepRecord) -> SweepRecord:
        """With the jobs of another record of the same variant, asked for later, in order of first appearance."""
        jobs, superseded = _told_apart((*self.superseded, *self.jobs, *other.jobs))
        needed = tuple(dict.fromkeys((*self.needed, *other.needed)))
        priors = tuple(dict.fromkeys((*self.priors, *other.priors)))
        deployments, _ = _told_apart((*self.deployments, *other.deployments))
        return dataclasses.replace(
            self, jobs=jobs, superseded=superseded, needed=needed, priors=priors,
            deployments=deployments_of(jobs, deployments),
        )  # fmt: skip


def deployments_of(jobs: Iterable[Job], deployments: Iterable[Job]) -> tuple[Job, ...]:
    """Those deployments whose policies are of some of these jobs."""
    runs = {job.id for job in jobs}
    return tuple(deployment for deployment in deployments if runs.issuperset(deployment.requires))


def deployments_first(jobs: Iterable[Job], sweeps: Iterable[SweepRecord]) -> list[Job]:
    """The order in which they start where several can: a deployment takes minutes and shows what the hours before it
    were worth, so it does not wait for other runs.
    """
    deployments = {job for sweep in sweeps for job in sweep.deployments}
    return sorted(jobs, key=lambda job: job not in deployments)


def write_sweep(path: Path, sweep: SweepRecord) -> None:
    """Superseded jobs stand before what replaced them."""
    order = {job.place: at for at, job in enumerate(sweep.jobs)}
    jobs = sorted((*sweep.superseded, *sweep.jobs), key=lambda job: order[job.place])
    content = {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(dataclasses.replace(sweep, jobs=tuple(jobs)))}
    del content["superseded"]
    for name in ("priors", "deployments"):
        if not content[name]:
            del content[name]  # earlier programs know none
    write_json(path, content)


def _told_apart(named: Sequence[Job]) -> tuple[tuple[Job, ...], tuple[Job, ...]]:
    """Of jobs that were named one after the other, the last in each place; and those that they superseded."""
    latest = {job.place: job for job in named}
    return tuple(latest.values()), tuple(dict.fromkeys(job for job in named if latest[job.place].id != job.id))


def required(jobs: Iterable[Job], among: Iterable[Job]) -> set[str]:
    """Ids of the runs that jobs need, and that those need, as far as they are among."""
    requires = {job.id: job.requires for job in among}
    left, needed = [run for job in jobs for run in job.requires], set[str]()
    while left:
        run = left.pop()
        left += () if run in needed else requires.get(run, ())
        needed.add(run)
    return needed


def read_sweeps(layout: Layout, experiment: str | None = None) -> list[SweepRecord]:
    """All variants of all experiments, sorted by both, or of one: UserError where it was never run here."""
    sweeps, damage = readable_sweeps(layout, experiment)
    if damage:
        raise damage[0]
    if experiment is not None and not sweeps:
        raise never_run(layout, experiment)
    return sweeps


def readable_sweeps(layout: Layout, experiment: str | None = None) -> tuple[list[SweepRecord], list[UserError]]:
    """What could be read, and what could not, for those who can go on without a damaged record.

    Raises VersionError where a record is of another schema version: so is what belongs to it, then.
    """
    experiments = layout.experiments() if experiment is None else [experiment]
    sweeps: list[SweepRecord | None] = []
    damage: list[UserError] = []
    for path in (file for name in experiments for file in layout.sweep_files(name)):
        try:
            sweeps.append(read_sweep(path))
        except (DamagedError, StorageError) as error:
            damage.append(error)
    return [sweep for sweep in sweeps if sweep is not None], damage  # None: removed since the folder was listed


def read_sweep(path: Path) -> SweepRecord | None:
    """The record in this file; None where there is none."""
    command = f"the `rrmctl run {path.parent.name} ...` that made it"
    hint = f"{command} sets it aside, makes it again and trains nothing twice"
    sweep = read_record(SweepRecord, path, hint, "needed priors deployments superseded")
    if sweep is None:
        return None
    if (sweep.experiment, sweep.variant) != (path.parent.name, path.stem):  # files are named after what they say
        problem = f"it is the record of {sweep.experiment!r} ({sweep.variant!r})"
        raise DamagedError(f"{path} is damaged: {problem}", hint)
    everything = (*sweep.jobs, *sweep.needed, *sweep.deployments)
    requires = {job.id: job.requires for job in everything if job.requires}
    try:
        graphlib.TopologicalSorter(requires).prepare()
    except graphlib.CycleError as error:
        problem = f"runs need each other in a circle: {', '.join(error.args[1])}"
        raise DamagedError(f"{path} is damaged: {problem}", hint) from None
    jobs, superseded = _told_apart(sweep.jobs)
    return dataclasses.replace(sweep, jobs=jobs, superseded=superseded)


def set_damaged_aside(layout: Layout, path: Path) -> str | None:
    """Make room for a new record where the one at `path` is damaged; what a person should know of that."""
    with locked(layout.sweep_lock(path.parent.name)):
        try:
            read_sweep(path)
        except DamagedError as error:
            aside = set_aside(path, "corrupt").name
            return f"{error}; set aside as {aside} and written anew, with what is asked for now and nothing else"
    return None


def record_sweep(layout: Layout, asked: SweepRecord) -> SweepRecord:
    """Add what was asked for to the sweep's record, and return the union. Any number of processes may do so at once."""
    path = layout.sweep(asked.experiment, asked.variant)
    with locked(layout.sweep_lock(asked.experiment)):
        remove_leftovers(path.parent)
        recorded = read_sweep(path)
        union = (recorded or asked).union(asked)
        if union != recorded:
            write_sweep(path, union)
    return union


def unused_runs(layout: Layout) -> list[str]:
    """Ids of the runs below the results root that no record names, sorted. One that cannot be read may name any run."""
    named = {job.id for sweep in read_sweeps(layout) for job in sweep.everything}
    return [run for run in layout.run_ids() if run not in named]


def remove_unused(layout: Layout, runs: Iterable[str], *, labels: bool = False) -> list[str]:
    """Remove those of these runs that are unused still and that no process owns, each as a whole; their ids. What holds
    answers of people goes only with `labels`.

    Records forget what was superseded and is gone. While it works no command records a sweep.
    """
    with contextlib.ExitStack() as recording_kept_out:
        for experiment in layout.experiments():
            recording_kept_out.enter_context(locked(layout.sweep_lock(experiment)))
        for half in (layout.root / "runs").glob(".*.removed"):  # what was begun by one that was killed
            shutil.rmtree(half)
        gone = [run for run in unused_runs(layout) if run in set(runs) and _remove(layout.run(run), labels=labels)]
        for sweep in read_sweeps(layout):
            left = tuple(job for job in sweep.superseded if job.id not in gone)
            if left != sweep.superseded:
                write_sweep(layout.sweep(sweep.experiment, sweep.variant), dataclasses.replace(sweep, superseded=left))
    return gone


def _remove(run: RunFolder, *, labels: bool) -> bool:
    """Remove a run's folder, unless a process owns the run. Renamed first: nobody finds half of it."""
    lease = None if run.labels.exists() and not labels else Lease.take(run, patience_s=PATIENCE_S)
    if lease is None:
        return False
    aside = run.path.with_name(f".{run.id}.removed")
    try:
        run.path.rename(aside)
        sync_folder(aside.parent)
        shutil.rmtree(aside)
    except OSError as error:
        raise storage_error(run.path, error, "remove") from error
    finally:
        lease.release()
    return True
