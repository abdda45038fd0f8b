"""Where a run stands: its small JSON record, the end of its log, and what others make of both."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from pydantic import ConfigDict, StrictBool, StrictFloat, StrictInt, StrictStr

from rrm.files import open_regular
from rrmctl.commands import rrmctl
from rrmctl.store.files import PATIENCE_S, DamagedError, StorageError
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.lease import Lease, LeaseLostError
from rrmctl.store.owner import is_owned
from rrmctl.store.records import read_record, write_json
from rrmctl.store.schema import SCHEMA_VERSION
from rrmctl.store.sweeps import Job, readable_sweeps


class RunState(StrEnum):
    """Where a run stands."""

    QUEUED = "queued"  #: asked for, never started
    RUNNING = "running"  #: a living process owns it
    INTERRUPTED = "interrupted"  #: stopped or died before its end; goes on from its checkpoint
    WAITING = "waiting"  #: checkpointed until answers or the like come from outside; its error says what
    FAILED = "failed"  #: its own fault; see the error
    DONE = "done"
    UNREADABLE = "unreadable"  #: its status file is damaged, or cannot be read now
    BLOCKED = "blocked"  #: a run that it needs has failed; never written, see `statuses`


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
    """The run's status as written; a fresh one where there is none."""
    resume = rrmctl("resume", results=folder.results)
    hint = f"move it away: `{resume}` goes on from the curve and the checkpoint"
    return read_record(Status, folder.status, hint) or Status()


def write_status(folder: RunFolder, status: Status) -> None:
    """Replace the run's status. Only for the holder of its lock."""
    write_json(folder.status, {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(status)})


def record_failure(folder: RunFolder, error: RunError) -> None:
    """Record that a run failed whose worker could not say so, if that is its end (`ErrorKind.DAMAGED` is not).

    Leaves a run alone that another process owns by now.
    """
    lease = None if error.kind is ErrorKind.DAMAGED else Lease.take(folder, patience_s=PATIENCE_S)
    if lease is None:
        return
    try:
        with contextlib.suppress(LeaseLostError), lease.writing():
            status = read_status(folder)
            if status.state not in (RunState.DONE, RunState.FAILED):
                write_status(folder, dataclasses.replace(status, state=RunState.FAILED, error=error))
    finally:
        lease.release()


def run_status(folder: RunFolder) -> Status:
    """Where the run stands now: one that says it is running while nobody owns it is interrupted.

    A status file that is damaged, or cannot be read now, gives the state `unreadable` with the reason.
    """
    try:
        status = read_status(folder)
        if status.state is RunState.RUNNING and not is_owned(folder):
            return dataclasses.replace(status, state=RunState.INTERRUPTED)
    except (DamagedError, StorageError) as error:
        problem = RunError(kind=ErrorKind.STORAGE, type=type(error).__name__, message=str(error))
        return Status(state=RunState.UNREADABLE, error=problem)
    return status


def statuses(layout: Layout, jobs: Iterable[Job]) -> dict[str, Status]:
    """Status of every run named by `jobs`, by id. Ten thousand take well under a second.

    A run that is not done while one that it needs, and that is named as well, has failed is blocked, for its reason.
    """
    requires = {job.id: job.requires for job in jobs}
    states = {run: run_status(layout.run(run)) for run in requires}

    def look(run: str, above: frozenset[str] = frozenset()) -> Status:
        if states[run].state in (RunState.QUEUED, RunState.INTERRUPTED, RunState.WAITING):
            # Records that were put together by hand may need each other in a circle.
            for needed in (needed for needed in requires[run] if needed in states and needed not in above):
                cause = look(needed, above | {run})
                if cause.state in (RunState.FAILED, RunState.BLOCKED):
                    error = blocked_by(needed, cause.error)
                    states[run] = dataclasses.replace(states[run], state=RunState.BLOCKED, error=error)
                    break
        return states[run]

    return {run: look(run) for run in requires}


def blocked_by(run: str, error: RunError | None) -> RunError:
    """What keeps a run from starting: the failure of another, which it needs."""
    if error is not None and error.kind is ErrorKind.BLOCKED:
        return error  # the first cause says it all
    reason = f"run {run}, which it needs, failed: {error or 'no reason was recorded'}"
    return RunError(kind=ErrorKind.BLOCKED, type="Blocked", message=reason)


def speeds(jobs: Iterable[Job], states: Mapping[str, Status]) -> dict[tuple[str, str], float]:
    """The median speed of what has run so far, by task and method: environment steps per second, evaluation counted in
    where a run is done.
    """
    seen: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for job in jobs:
        status = states[job.id]
        took = status.wall_s if status.state is RunState.DONE else None
        if speed := status.step / took if took else status.steps_per_s:
            seen[job.task, job.method].append(speed)
    return {key: statistics.median(values) for key, values in seen.items()}


def stored_speeds(layout: Layout, known: Mapping[str, Status] | None = None) -> dict[tuple[str, str, str], float]:
    """The same of the store's runs, by task, method and variant; of those in `known` it is read already."""
    states, jobs = dict(known or {}), defaultdict[str, list[Job]](list)
    for sweep in readable_sweeps(layout)[0]:
        states |= statuses(layout, (job for job in sweep.everything if job.id not in states))
        jobs[sweep.variant] += sweep.everything
    return {(*key, variant): speed for variant, own in jobs.items() for key, speed in speeds(own, states).items()}


def log_tail(folder: RunFolder, lines: int = 15) -> list[str]:
    """The last lines of a run's log; none where it has not started, and why where it cannot be read."""
    try:
        with open_regular(folder.log) as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 400 * lines))
            return file.read().decode(errors="replace").splitlines()[-lines:]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        return [f"{folder.log} cannot be read: {error.strerror}"]
