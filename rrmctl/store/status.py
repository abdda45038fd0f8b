"""The small JSON records of a run: what it is, and where it stands."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pydantic import ConfigDict, StrictBool, StrictFloat, StrictInt, StrictStr

from rrmctl.commands import rrmctl
from rrmctl.store.files import DamagedError, set_aside
from rrmctl.store.layout import RunFolder
from rrmctl.store.locks import PATIENCE_S
from rrmctl.store.owner import lock_free
from rrmctl.store.records import check_version, read_json, validated, write_json
from rrmctl.store.schema import SCHEMA_VERSION


class RunState(StrEnum):
    """Where a run stands."""

    QUEUED = "queued"  #: asked for, never started
    RUNNING = "running"  #: a living process owns it
    INTERRUPTED = "interrupted"  #: stopped or died before its end; goes on from its checkpoint
    WAITING = "waiting"  #: checkpointed until answers or the like come from outside; its error says what
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
    DAMAGED = "damaged"  #: a file that others make for it is damaged or gone; once that is made again, it goes on
    MISSING = "missing"  #: a file of the user's is not there now
    WAITING = "waiting"  #: what must come from outside has not come yet
    BLOCKED = "blocked"  #: a run that it needs has failed


@dataclass(frozen=True, kw_only=True)
class RunError:
    """What stopped a run."""

    kind: ErrorKind
    type: StrictStr  #: the exception's class, or the signal's name
    message: StrictStr

    def __str__(self) -> str:
        # A place, a file or a run is named by the message; the class says no more.
        named = self.kind in (ErrorKind.STORAGE, ErrorKind.MISSING, ErrorKind.WAITING, ErrorKind.BLOCKED)
        return self.message if named else f"{self.type}: {self.message}"


@dataclass(frozen=True, kw_only=True)
class Status:
    """Contents of `status.json`. Times are seconds since the epoch, steps are environment steps."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    state: RunState = RunState.QUEUED
    attempt: StrictInt = 0  #: how often a worker took the run up
    step: StrictInt = 0  #: reached at the last heartbeat
    steps: StrictInt = 0  #: of the whole run
    rows: StrictInt = 0  #: evaluations known to be in the curve
    success: StrictFloat | None = None  #: of the last evaluation
    true_return: StrictFloat | None = None  #: of the last evaluation
    steps_per_s: StrictFloat | None = None
    wall_s: StrictFloat | None = None  #: training time at the last evaluation, seconds
    pid: StrictInt | None = None
    host: StrictStr | None = None
    started: StrictFloat | None = None  #: when the last attempt began
    heartbeat: StrictFloat | None = None
    discard: StrictBool = False  #: what the run holds is to be removed before it starts again
    error: RunError | None = None


def read_status(folder: RunFolder) -> Status:
    """The run's status as written; a fresh one where there is none.

    Raises:
        DamagedError: the file is damaged.
        StorageError: it cannot be read now.
        VersionError: it is of another schema version.
    """
    resume = rrmctl("resume", results=folder.results)
    hint = f"move it away: `{resume}` goes on from the curve and the checkpoint"
    content = read_json(folder.status)
    if content is None:
        return Status()
    check_version(content.pop("schema_version", None), folder.status, hint)
    return validated(Status, content, folder.status, hint)


def write_status(folder: RunFolder, status: Status) -> None:
    """Replace the run's status. Only for the holder of its lock."""
    write_json(folder.status, {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(status)})


def record_failure(folder: RunFolder, error: RunError) -> None:
    """Record that a run failed whose worker could not say so, if that is its end (`ErrorKind.DAMAGED` is not).

    Leaves a run alone that another process owns by now.

    Raises:
        StorageError: the folder takes no write.
        DamagedError, VersionError: its status is damaged, or of another version.
    """
    lock = None if error.kind is ErrorKind.DAMAGED else lock_free(folder, PATIENCE_S)
    if lock is None:
        return
    try:
        status = read_status(folder)
        if status.state not in (RunState.DONE, RunState.FAILED):
            write_status(folder, dataclasses.replace(status, state=RunState.FAILED, error=error))
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
