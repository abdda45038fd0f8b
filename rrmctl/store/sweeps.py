"""The record of what a sweep asked for: its jobs, and the runs that they are."""

from __future__ import annotations

import dataclasses
import graphlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self

from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.store import validation
from rrmctl.store.files import DamagedError, StorageError, locked, read_json, remove_leftovers, set_aside, write_json
from rrmctl.store.layout import Layout
from rrmctl.store.schema import SCHEMA_VERSION


@dataclass(frozen=True, kw_only=True)
class JobRecord:
    """One planned job: which run it is, and what it is called in its experiment."""

    id: str
    cell: str
    task: str
    method: str
    teacher: str
    feedback: str
    seed: int
    steps: int
    requires: tuple[str, ...] = ()  #: ids of the runs that must be done before it

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

    experiment: str
    variant: str
    profile: str
    overrides: dict[str, Any] = field(default_factory=dict)
    jobs: tuple[JobRecord, ...] = ()
    needed: tuple[JobRecord, ...] = ()  #: runs that jobs need; nothing reports them, and some may be jobs as well
    priors: tuple[str, ...] = ()  #: of `--prior`, which added methods to those of the manifest
    superseded: tuple[JobRecord, ...] = ()  #: another run was asked for in their place, of other settings or files

    @property
    def everything(self) -> tuple[JobRecord, ...]:
        """Every run, those that are only needed first; one that several rows share is there for each of them."""
        return (*self.merely_needed, *self.jobs)

    @property
    def merely_needed(self) -> tuple[JobRecord, ...]:
        """Runs that jobs need and that are no jobs themselves."""
        known = {job.id: job for job in (*self.superseded, *self.needed)}
        wanted = required(self.jobs, known.values()) - {job.id for job in self.jobs}
        return tuple(job for run, job in known.items() if run in wanted)

    def union(self, other: SweepRecord) -> SweepRecord:
        """With the jobs of another record of the same variant, asked for later, in order of first appearance."""
        jobs, superseded = _told_apart((*self.superseded, *self.jobs, *other.jobs))
        needed = tuple(dict.fromkeys((*self.needed, *other.needed)))
        priors = tuple(dict.fromkeys((*self.priors, *other.priors)))
        return dataclasses.replace(self, jobs=jobs, superseded=superseded, needed=needed, priors=priors)

    def to_json(self) -> dict[str, Any]:
        """A JSON object; `from_json` is the inverse. Superseded jobs stand before what replaced them."""
        order = {job.place: at for at, job in enumerate(self.jobs)}
        jobs = sorted((*self.superseded, *self.jobs), key=lambda job: order[job.place])
        content = dataclasses.asdict(dataclasses.replace(self, jobs=tuple(jobs)))
        left_out = {"superseded", *(() if self.priors else ("priors",))}  # earlier programs know no priors
        return {"schema_version": SCHEMA_VERSION, **{key: content[key] for key in content if key not in left_out}}

    @classmethod
    def from_json(cls, value: dict[str, Any], path: Path) -> Self:
        """The record read from `path`.

        Raises:
            VersionError: it is of another schema version.
            DamagedError: it lacks or mistakes a field, or is another sweep's: files are named after what it says.
        """
        content, hint = dict(value), _sweep_hint(path)
        validation.check_version(content, path, hint)
        validation.check(content, _SWEEP, path, hint)
        if (content["experiment"], content["variant"]) != (path.parent.name, path.stem):
            told = f"{content['experiment']!r} ({content['variant']!r})"
            raise DamagedError(f"{path} is damaged: it is the record of {told}", hint)
        try:
            named, needed = (_jobs(content.pop(name, []), name, path) for name in ("jobs", "needed"))
            _check_order((*named, *needed), path)
            jobs, superseded = _told_apart(named)
            priors = content.pop("priors", [])
            validation.check({"priors": priors}, {"priors": validation.LIST}, path, hint)
            texts = {f"priors[{number}]": prior for number, prior in enumerate(priors)}
            validation.check(texts, dict.fromkeys(texts, validation.TEXT), path, hint)
            return cls(**content, jobs=jobs, superseded=superseded, needed=needed, priors=tuple(priors))
        except TypeError as problem:  # a field nobody knows
            raise DamagedError(f"{path} is damaged: {problem}", hint) from problem


def _told_apart(named: Sequence[JobRecord]) -> tuple[tuple[JobRecord, ...], tuple[JobRecord, ...]]:
    """Of jobs that were named one after the other, the last in each place; and those that they superseded."""
    latest = {job.place: job for job in named}
    return tuple(latest.values()), tuple(dict.fromkeys(job for job in named if latest[job.place].id != job.id))


class Requiring(Protocol):
    """A planned or recorded job."""

    @property
    def id(self) -> str:
        """Of its run."""

    @property
    def requires(self) -> tuple[str, ...]:
        """Ids of the runs that must be done before it."""


def required(jobs: Iterable[Requiring], known: Iterable[Requiring]) -> set[str]:
    """Ids of the runs that jobs need, and that those need, as far as they are known."""
    requires = {job.id: job.requires for job in known}
    left, found = [run for job in jobs for run in job.requires], set[str]()
    while left:
        run = left.pop()
        left += () if run in found else requires.get(run, ())
        found.add(run)
    return found


_SWEEP = {
    **dict.fromkeys(("experiment", "variant", "profile"), validation.TEXT),
    "overrides": validation.OBJECT,
    "jobs": validation.LIST,
}

_JOB = dict.fromkeys(("id", "cell", "task", "method", "teacher", "feedback"), validation.TEXT) | dict.fromkeys(
    ("seed", "steps"), validation.WHOLE
)


def _jobs(values: Any, name: str, path: Path) -> tuple[JobRecord, ...]:
    validation.check({name: values}, {name: validation.LIST}, path, _sweep_hint(path))
    return tuple(_job(value, f"{name}[{number}]", path) for number, value in enumerate(values))


def _job(value: Any, where: str, path: Path) -> JobRecord:
    hint = _sweep_hint(path)
    validation.check({where: value}, {where: validation.OBJECT}, path, hint)
    validation.check(value, _JOB, path, hint, f"{where}.")
    validation.check_run_id(value["id"], path, hint, f"{where}.id")
    requires = value.get("requires", [])
    validation.check({f"{where}.requires": requires}, {f"{where}.requires": validation.LIST}, path, hint)
    for run in requires:
        validation.check({f"{where}.requires": run}, {f"{where}.requires": validation.TEXT}, path, hint)
        validation.check_run_id(run, path, hint, f"{where}.requires")
    return JobRecord(**{**value, "requires": tuple(requires)})


def _check_order(jobs: Sequence[JobRecord], path: Path) -> None:
    requires = {job.id: job.requires for job in jobs if job.requires}
    try:
        graphlib.TopologicalSorter(requires).prepare()
    except graphlib.CycleError as problem:
        circle = ", ".join(problem.args[1])
        raise DamagedError(
            f"{path} is damaged: runs need each other in a circle: {circle}", _sweep_hint(path)
        ) from None


def _sweep_hint(path: Path) -> str:
    return (
        f"the `rrmctl run {path.parent.name} ...` that made it sets it aside, makes it again and trains nothing twice"
    )


def read_sweeps(layout: Layout, experiment: str | None = None) -> list[SweepRecord]:
    """All variants of an experiment, or of all experiments, sorted by experiment and variant.

    Raises:
        UserError: a record is damaged, cannot be read now, or is of another schema version.
    """
    sweeps, damage = readable_sweeps(layout, experiment)
    if damage:
        raise damage[0]
    return sweeps


def readable_sweeps(layout: Layout, experiment: str | None = None) -> tuple[list[SweepRecord], list[UserError]]:
    """Like `read_sweeps`, for those who can go on without a damaged record: what could be read, and what could not.

    Raises:
        VersionError: a record is of another schema version; so is what belongs to it, then.
    """
    experiments = layout.experiments() if experiment is None else [experiment]
    sweeps: list[SweepRecord] = []
    damage: list[UserError] = []
    for path in (file for name in experiments for file in layout.sweep_files(name)):
        try:
            sweep = read_sweep(path)
        except (DamagedError, StorageError) as error:
            damage.append(error)
            continue
        if sweep is not None:  # not removed since the folder was listed
            sweeps.append(sweep)
    return sweeps, damage


def read_sweep(path: Path) -> SweepRecord | None:
    """The record in this file; None where there is none.

    Raises:
        UserError: it is damaged, cannot be read now, or is of another schema version.
    """
    try:
        value = read_json(path)
    except DamagedError as error:
        raise DamagedError(str(error), _sweep_hint(path)) from error
    return None if value is None else SweepRecord.from_json(value, path)


def set_damaged_aside(layout: Layout, path: Path) -> str | None:
    """Make room for a new record where the one at `path` is damaged; what a person should know of that.

    Raises:
        StorageError: it cannot be read now, or the results folder takes no write.
        VersionError: it is of another schema version.
    """
    with locked(layout.sweep_lock(path.parent.name)):
        try:
            read_sweep(path)
        except DamagedError as error:
            aside = set_aside(path, "corrupt").name
            return f"{error}; set aside as {aside} and written anew, with what is asked for now and nothing else"
    return None


def record_sweep(layout: Layout, asked: SweepRecord) -> SweepRecord:
    """Add what was asked for to the sweep's record, and return the union. Any number of processes may do so at once.

    Raises:
        StorageError: the results folder takes no write.
        DamagedError, VersionError: the record that is there is damaged, or of another version.
    """
    path = layout.sweep(asked.experiment, asked.variant)
    with locked(layout.sweep_lock(asked.experiment)):
        remove_leftovers(path.parent)
        known = read_sweep(path)
        union = (known or asked).union(asked)
        if union != known:
            write_json(path, union.to_json())
    return union
