"""The small JSON records of the store: what a sweep asked for, and where a run stands."""

from __future__ import annotations

import dataclasses
import graphlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from rrmctl.errors import UserError
from rrmctl.store import shape
from rrmctl.store.atomic import (
    PATIENCE_S,
    DamagedError,
    StorageError,
    locked,
    read_json,
    remove_leftovers,
    set_aside,
    try_lock,
    write_json,
)
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.schema import SCHEMA_VERSION


class State(StrEnum):
    """Where a run stands."""

    QUEUED = "queued"  #: asked for, never started
    RUNNING = "running"  #: a living process owns it
    INTERRUPTED = "interrupted"  #: stopped or died before its end; goes on from its checkpoint
    FAILED = "failed"  #: its own fault; see the error
    DONE = "done"
    UNREADABLE = "unreadable"  #: its status file is damaged, or cannot be read now
    BLOCKED = "blocked"  #: a run that it needs has failed; never written, see `rrmctl.store.reader.statuses`


class ErrorKind(StrEnum):
    """Why a run is not done, which decides whether trying again makes sense."""

    REFUSED = "refused"  #: a mistake in what it was given; the same again would fail again
    CRASHED = "crashed"  #: an exception nobody foresaw
    KILLED = "killed"  #: ended by a signal from outside
    HUNG = "hung"  #: gave no sign of life and was ended
    MEMORY = "memory"  #: took more memory than it may and was ended
    STORAGE = "storage"  #: the results folder took no write
    BLOCKED = "blocked"  #: a run that it needs has failed


@dataclass(frozen=True, kw_only=True)
class RunError:
    """What stopped a run."""

    kind: ErrorKind
    type: str  #: the exception's class, or the signal's name
    message: str

    def __str__(self) -> str:
        # A place that takes no write, or a run that failed, is named by the message; the class says no more.
        named = self.kind in (ErrorKind.STORAGE, ErrorKind.BLOCKED)
        return self.message if named else f"{self.type}: {self.message}"

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """The inverse of `dataclasses.asdict`."""
        return cls(kind=ErrorKind(value["kind"]), type=str(value["type"]), message=str(value["message"]))


@dataclass(frozen=True, kw_only=True)
class Status:
    """Contents of `status.json`. Times are seconds since the epoch, steps are environment steps."""

    state: State = State.QUEUED
    attempt: int = 0  #: how often a worker took the run up
    step: int = 0  #: reached at the last heartbeat
    steps: int = 0  #: of the whole run
    rows: int = 0  #: evaluations known to be in the curve
    success: float | None = None  #: of the last evaluation
    true_return: float | None = None  #: of the last evaluation
    steps_per_s: float | None = None
    wall_s: float | None = None  #: training time at the last evaluation, seconds
    pid: int | None = None
    host: str | None = None
    started: float | None = None  #: when the last attempt began
    heartbeat: float | None = None
    discard: bool = False  #: what the run holds is to be removed before it starts again
    error: RunError | None = None

    def to_json(self) -> dict[str, Any]:
        """A JSON object; `from_json` is the inverse."""
        return {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, value: dict[str, Any], path: Path) -> Self:
        """The status read from `path`.

        Raises:
            VersionError: it is of another schema version.
            DamagedError: it lacks or mistakes a field.
        """
        content = dict(value)
        shape.check_version(content, path, _STATUS_HINT)
        shape.check(content, _STATUS, path, _STATUS_HINT)
        error = content.pop("error")
        if error is not None:
            shape.check(error, _ERROR, path, _STATUS_HINT, "error.")
        try:
            state = State(content.pop("state"))
            return cls(**content, state=state, error=None if error is None else RunError.from_json(error))
        except (TypeError, ValueError) as problem:  # a word that is no state, a field nobody knows
            raise DamagedError(f"{path} is damaged: {problem}", _STATUS_HINT) from problem


_STATUS_HINT = "move it away: `rrmctl resume` goes on from the curve and the checkpoint"

_ERROR = dict.fromkeys(("kind", "type", "message"), shape.TEXT)

_STATUS = (
    {"state": shape.TEXT, "discard": shape.FLAG, "error": shape.OBJECT + shape.NONE}
    | dict.fromkeys(("attempt", "step", "steps", "rows"), shape.WHOLE)
    | dict.fromkeys(
        ("success", "true_return", "steps_per_s", "wall_s", "started", "heartbeat"), shape.NUMBER + shape.NONE
    )
    | {"pid": shape.WHOLE + shape.NONE, "host": shape.TEXT + shape.NONE}
)


def read_status(folder: RunFolder) -> Status:
    """The run's status as written; a fresh one where there is none.

    Raises:
        DamagedError: the file is damaged.
        StorageError: it cannot be read now.
        VersionError: it is of another schema version.
    """
    value = read_json(folder.status)
    return Status() if value is None else Status.from_json(value, folder.status)


def write_status(folder: RunFolder, status: Status) -> None:
    """Replace the run's status. Only for the holder of its lock."""
    write_json(folder.status, status.to_json())


def record_failure(folder: RunFolder, error: RunError) -> None:
    """Record that a run failed whose worker could not say so. Leaves a run alone that another process owns by now.

    Raises:
        StorageError: the folder takes no write.
        DamagedError, VersionError: its status is damaged, or of another version.
    """
    lock = try_lock(folder.lock, PATIENCE_S)
    if lock is None:
        return
    try:
        status = read_status(folder)
        if status.state not in (State.DONE, State.FAILED):
            write_status(folder, dataclasses.replace(status, state=State.FAILED, error=error))
    finally:
        os.close(lock)


def record_config(folder: RunFolder, content: dict[str, Any]) -> str | None:
    """Write the run's `config.json` unless it says the same already. A damaged one is set aside first.

    Returns:
        What a person should know of a file that was set aside.

    Raises:
        StorageError: the results folder takes no write.
    """
    note = None
    try:
        known = read_json(folder.config)
    except DamagedError as error:
        known = None
        if folder.config.exists():
            note = f"{error}; set aside as {set_aside(folder.config, 'corrupt').name} and written anew"
    if known != content:
        write_json(folder.config, content)
    return note


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
    def label(self) -> str:
        """For people: task, method, teacher and feedback where they say something, seed."""
        words = [
            self.task,
            self.method,
            *(w for w in (self.teacher, self.feedback) if w not in ("", "-")),
            f"seed {self.seed}",
        ]
        return " ".join(words)


@dataclass(frozen=True, kw_only=True)
class SweepRecord:
    """What `run` was asked for: one variant (profile and overrides) of an experiment."""

    experiment: str
    variant: str
    profile: str
    overrides: dict[str, Any] = field(default_factory=dict)
    jobs: tuple[JobRecord, ...] = ()
    needed: tuple[JobRecord, ...] = ()  #: runs that jobs need; nothing reports them, and some may be jobs as well

    @property
    def everything(self) -> tuple[JobRecord, ...]:
        """Every run, those that are only needed first; one that several rows share is there for each of them."""
        return (*self.merely_needed, *self.jobs)

    @property
    def merely_needed(self) -> tuple[JobRecord, ...]:
        """Runs that jobs need and that are no jobs themselves."""
        asked = {job.id for job in self.jobs}
        return tuple(job for job in self.needed if job.id not in asked)

    def union(self, other: SweepRecord) -> SweepRecord:
        """With the jobs of another record of the same variant, in order of first appearance."""
        jobs, needed = (dict.fromkeys(both) for both in ((*self.jobs, *other.jobs), (*self.needed, *other.needed)))
        return dataclasses.replace(self, jobs=tuple(jobs), needed=tuple(needed))

    def to_json(self) -> dict[str, Any]:
        """A JSON object; `from_json` is the inverse."""
        return {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, value: dict[str, Any], path: Path) -> Self:
        """The record read from `path`.

        Raises:
            VersionError: it is of another schema version.
            DamagedError: it lacks or mistakes a field, or is another sweep's: files are named after what it says.
        """
        content, hint = dict(value), _sweep_hint(path)
        shape.check_version(content, path, hint)
        shape.check(content, _SWEEP, path, hint)
        if (content["experiment"], content["variant"]) != (path.parent.name, path.stem):
            told = f"{content['experiment']!r} ({content['variant']!r})"
            raise DamagedError(f"{path} is damaged: it is the record of {told}", hint)
        try:
            jobs, needed = (_jobs(content.pop(name, []), name, path) for name in ("jobs", "needed"))
            _check_order((*jobs, *needed), path)
            return cls(**content, jobs=jobs, needed=needed)
        except TypeError as problem:  # a field nobody knows
            raise DamagedError(f"{path} is damaged: {problem}", hint) from problem


_SWEEP = {
    **dict.fromkeys(("experiment", "variant", "profile"), shape.TEXT),
    "overrides": shape.OBJECT,
    "jobs": shape.LIST,
}

_JOB = dict.fromkeys(("id", "cell", "task", "method", "teacher", "feedback"), shape.TEXT) | dict.fromkeys(
    ("seed", "steps"), shape.WHOLE
)


def _jobs(values: Any, name: str, path: Path) -> tuple[JobRecord, ...]:
    shape.check({name: values}, {name: shape.LIST}, path, _sweep_hint(path))
    return tuple(_job(value, f"{name}[{number}]", path) for number, value in enumerate(values))


def _job(value: Any, where: str, path: Path) -> JobRecord:
    hint = _sweep_hint(path)
    shape.check({where: value}, {where: shape.OBJECT}, path, hint)
    shape.check(value, _JOB, path, hint, f"{where}.")
    shape.check_run_id(value["id"], path, hint, f"{where}.id")
    requires = value.get("requires", [])
    shape.check({f"{where}.requires": requires}, {f"{where}.requires": shape.LIST}, path, hint)
    for run in requires:
        shape.check({f"{where}.requires": run}, {f"{where}.requires": shape.TEXT}, path, hint)
        shape.check_run_id(run, path, hint, f"{where}.requires")
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
        f"move it away; the `rrmctl run {path.parent.name} ...` that made it makes it again, and trains nothing twice"
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
