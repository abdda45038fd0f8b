"""The small JSON records of the store: what a sweep asked for, and where a run stands."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from rrmctl.store.atomic import DamagedError, locked, read_json, remove_leftovers, try_lock, write_json
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.schema import SCHEMA_VERSION


class State(StrEnum):
    """Where a run stands."""

    QUEUED = "queued"  #: asked for, never started
    RUNNING = "running"  #: a living process owns it
    INTERRUPTED = "interrupted"  #: stopped or died before its end; goes on from its checkpoint
    FAILED = "failed"  #: its own fault; see the error
    DONE = "done"
    UNREADABLE = "unreadable"  #: its status file is damaged


class ErrorKind(StrEnum):
    """Why a run is not done, which decides whether trying again makes sense."""

    REFUSED = "refused"  #: a mistake in what it was given; the same again would fail again
    CRASHED = "crashed"  #: an exception nobody foresaw
    KILLED = "killed"  #: ended by a signal
    HUNG = "hung"  #: gave no sign of life and was ended
    STORAGE = "storage"  #: the results folder took no write


@dataclass(frozen=True, kw_only=True)
class RunError:
    """What stopped a run."""

    kind: ErrorKind
    type: str  #: the exception's class, or the signal's name
    message: str

    def __str__(self) -> str:
        return f"{self.type}: {self.message}"

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
            DamagedError: it is of another version, or lacks or mistakes a field.
        """
        content = dict(value)
        _check_version(content.pop("schema_version", None), path)
        try:
            error = content.pop("error")
            state = State(content.pop("state"))
            return cls(**content, state=state, error=None if error is None else RunError.from_json(error))
        except (KeyError, TypeError, ValueError) as problem:
            raise DamagedError(f"{path} is not a run's status: {problem}", "move it away") from problem


def read_status(folder: RunFolder) -> Status:
    """The run's status as written; a fresh one where there is none.

    Raises:
        DamagedError: the file is damaged.
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
        DamagedError: its status is damaged.
    """
    lock = try_lock(folder.lock)
    if lock is None:
        return
    try:
        status = read_status(folder)
        if status.state not in (State.DONE, State.FAILED):
            write_status(folder, dataclasses.replace(status, state=State.FAILED, error=error))
    finally:
        os.close(lock)


def record_config(folder: RunFolder, content: dict[str, Any]) -> None:
    """Write the run's `config.json` unless it says the same already.

    Raises:
        StorageError: the results folder takes no write.
        DamagedError: the file that is there is damaged.
    """
    if read_json(folder.config) != content:
        write_json(folder.config, content)


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

    def with_jobs(self, jobs: Iterable[JobRecord]) -> SweepRecord:
        """The union, in order of first appearance."""
        return dataclasses.replace(self, jobs=tuple(dict.fromkeys((*self.jobs, *jobs))))

    def to_json(self) -> dict[str, Any]:
        """A JSON object; `from_json` is the inverse."""
        return {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, value: dict[str, Any], path: Path) -> Self:
        """The record read from `path`.

        Raises:
            DamagedError: it is of another version, or lacks or mistakes a field.
        """
        content = dict(value)
        _check_version(content.pop("schema_version", None), path)
        try:
            jobs = tuple(JobRecord(**job) for job in content.pop("jobs"))
            return cls(**content, jobs=jobs)
        except (KeyError, TypeError) as problem:
            raise DamagedError(f"{path} is not a sweep's record: {problem}", "move it away and run again") from problem


def read_sweeps(layout: Layout, experiment: str | None = None) -> list[SweepRecord]:
    """All variants of an experiment, or of all experiments, sorted by experiment and variant.

    Raises:
        DamagedError: a record is damaged.
    """
    experiments = layout.experiments() if experiment is None else [experiment]
    records = []
    for path in (file for name in experiments for file in layout.sweep_files(name)):
        value = read_json(path)
        if value is not None:  # removed since the folder was listed
            records.append(SweepRecord.from_json(value, path))
    return records


def record_sweep(layout: Layout, asked: SweepRecord) -> SweepRecord:
    """Add what was asked for to the sweep's record, and return the union. Any number of processes may do so at once.

    Raises:
        StorageError: the results folder takes no write.
        DamagedError: the record that is there is damaged.
    """
    path = layout.sweep(asked.experiment, asked.variant)
    with locked(layout.sweep_lock(asked.experiment)):
        remove_leftovers(path.parent)
        value = read_json(path)
        known = asked if value is None else SweepRecord.from_json(value, path)
        union = known.with_jobs(asked.jobs)
        if value is None or union != known:
            write_json(path, union.to_json())
    return union


def _check_version(version: object, path: Path) -> None:
    if version != SCHEMA_VERSION:
        raise DamagedError(
            f"{path} is of schema version {version}, this program reads version {SCHEMA_VERSION}",
            "use the rrmctl that wrote it, or another --results folder",
        )
