"""The small JSON records of a run: what it is, and where it stands."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from rrmctl.commands import rrmctl
from rrmctl.store import validation
from rrmctl.store.files import (
    PATIENCE_S,
    DamagedError,
    read_json,
    set_aside,
    write_json,
)
from rrmctl.store.layout import RunFolder
from rrmctl.store.owner import lock_free
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
    type: str  #: the exception's class, or the signal's name
    message: str

    def __str__(self) -> str:
        # A place, a file or a run is named by the message; the class says no more.
        named = self.kind in (ErrorKind.STORAGE, ErrorKind.MISSING, ErrorKind.WAITING, ErrorKind.BLOCKED)
        return self.message if named else f"{self.type}: {self.message}"

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """The inverse of `dataclasses.asdict`."""
        return cls(kind=ErrorKind(value["kind"]), type=str(value["type"]), message=str(value["message"]))


@dataclass(frozen=True, kw_only=True)
class Status:
    """Contents of `status.json`. Times are seconds since the epoch, steps are environment steps."""

    state: RunState = RunState.QUEUED
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
        content, hint = dict(value), _hint(path)
        validation.check_version(content, path, hint)
        validation.check(content, _STATUS, path, hint)
        error = content.pop("error")
        if error is not None:
            validation.check(error, _ERROR, path, hint, "error.")
        try:
            state = RunState(content.pop("state"))
            return cls(**content, state=state, error=None if error is None else RunError.from_json(error))
        except (TypeError, ValueError) as problem:  # a word that is no state, a field nobody knows
            raise DamagedError(f"{path} is damaged: {problem}", hint) from problem


def _hint(path: Path) -> str:
    resume = rrmctl("resume", results=RunFolder(path.parent).results)
    return f"move it away: `{resume}` goes on from the curve and the checkpoint"


_ERROR = dict.fromkeys(("kind", "type", "message"), validation.TEXT)

_STATUS = (
    {"state": validation.TEXT, "discard": validation.FLAG, "error": validation.OBJECT + validation.NONE}
    | dict.fromkeys(("attempt", "step", "steps", "rows"), validation.WHOLE)
    | dict.fromkeys(
        ("success", "true_return", "steps_per_s", "wall_s", "started", "heartbeat"), validation.NUMBER + validation.NONE
    )
    | {"pid": validation.WHOLE + validation.NONE, "host": validation.TEXT + validation.NONE}
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
