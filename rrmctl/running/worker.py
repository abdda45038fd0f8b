"""The child process: takes up one run, trains it and records what happens, until it is done or told to stop.

    python -m rrmctl.running.worker RESULTS RUN [--fresh ATTEMPT] [--pipe FD] [--parent PID] [--asked JSON]

Neither torch nor a simulator is imported before the run's lock is held: losing the race for a run costs little.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shutil
import socket
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from rrm.devices import CPU, check_device
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.running.config_file import MissingFileError, load_config
from rrmctl.running.monitor import RunMonitor
from rrmctl.running.parent_link import Leave, Pipe, StopRequest, say
from rrmctl.store import files, provenance
from rrmctl.store.curve import CurveWriter
from rrmctl.store.files import PATIENCE_S
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.lease import Lease, LeaseLostError
from rrmctl.store.owner import Beat
from rrmctl.store.provenance import read_config
from rrmctl.store.schema import IDENTITY
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status, write_status
from rrmctl.terminal import attend

if TYPE_CHECKING:
    from rrm.training.jobs import Monitor
    from rrm.training.run_config import JobConfig
    from rrm.tuning import Choice

_T = TypeVar("_T")


class WorkerExit(IntEnum):
    """Exit codes of a worker."""

    DONE = 0
    CRASHED = 1  #: what may go well the next time; where nobody foresaw it, its traceback is in the log
    REFUSED = 2  #: a mistake in what it was given; trying again would not help
    MISSING = 66  #: a file of the user's is not there now
    WAITING = 69  #: checkpointed; what must come from outside has not come yet
    STORAGE = 74  #: the results folder took no write
    STOPPED = 75  #: checkpointed; the next worker goes on
    LOCKED = 76  #: another process owns the run


class Trainable(Protocol):
    """What the worker needs of `rrm.training.jobs`."""

    def perform(self, config: JobConfig, folder: Path, monitor: Monitor, results: Mapping[str, Path]) -> bool:
        """Do the job until done (True) or told to stop (False); `results`: folders of the runs it requires, by id."""

    def fingerprint(self, config: JobConfig) -> dict[str, str]:
        """Which environment this is."""

    def choose_products(self, earlier: Choice | None) -> Choice:
        """Multiply as an earlier attempt did, where that can be. Returns how products are made from now on."""


def main(argv: Sequence[str] | None = None, trainer: Trainable | None = None) -> WorkerExit:
    """Take up one run; `trainer` stands in for `rrm.training.jobs`."""
    parser = argparse.ArgumentParser(
        prog="python -m rrmctl.running.worker", description="Trains one run of a results folder."
    )
    parser.add_argument("results", type=Path)
    parser.add_argument("run")
    parser.add_argument(
        "--fresh", type=int, metavar="ATTEMPT", help="remove what the run holds first, unless there was a later attempt"
    )
    parser.add_argument("--pipe", type=int, help="descriptor that takes progress, one JSON object per line")
    parser.add_argument("--parent", type=int, help="process whose death means: checkpoint and leave")
    parser.add_argument("--take-over", default="", metavar="OWNER:COUNT", help="the last sign of life of who holds it")
    parser.add_argument("--asked", type=json.loads, default=[], help="the command that asked for the run, as JSON")
    given = parser.parse_args(argv)
    folder = Layout(given.results).run(given.run)
    pipe = Pipe(given.pipe)
    owner, _, count = given.take_over.partition(":")
    stale = Beat(owner, int(count)) if owner else None
    with StopRequest(given.parent, pipe) as stop:
        try:
            read_config(folder)
            with stop.at_once():
                lease = Lease.take(folder, patience_s=PATIENCE_S, stale=stale, waiting=lambda: pipe.beat("wait"))
        except Leave:
            return WorkerExit.STOPPED
        except UserError as error:
            return _report(folder, error, pipe)
        if lease is None:
            return WorkerExit.LOCKED
        try:
            return _attempt(lease, given, pipe, stop, trainer)
        except LeaseLostError as error:
            say(f"--- {error}; what was done here since the last write is discarded")
            return WorkerExit.LOCKED
        except Exception as error:
            return _report(folder, error, pipe, lease)
        finally:
            lease.release()


def _attempt(
    lease: Lease, given: argparse.Namespace, pipe: Pipe, stop: StopRequest, trainer: Trainable | None
) -> WorkerExit:
    folder = lease.folder
    with lease.writing():
        files.remove_leftovers(folder.path)
        before = _healed(folder.status, pipe, lambda: read_status(folder))
        fresh = given.fresh is not None and before.attempt <= given.fresh
        if before.state is RunState.DONE and not fresh:
            return WorkerExit.DONE
        status = _take_up(folder, before, fresh=fresh)
    say(f"--- attempt {status.attempt}, process {os.getpid()}, {time.strftime('%Y-%m-%d %H:%M:%S')}")
    pipe.send(event="start", attempt=status.attempt, rows=status.rows)
    try:
        # Imports and the environment take many seconds on a loaded machine, and until training begins nothing is lost.
        with stop.at_once():
            config, stored = load_config(folder), read_config(folder)
            status = dataclasses.replace(status, steps=config.steps)
            identity = {"run": folder.id, **{name: stored[name] for name in IDENTITY if name != "run"}}
            with lease.writing():  # what is damaged is set aside
                curve = _healed(folder.curve, pipe, lambda: CurveWriter(folder, identity))
                # Its worker may have died between its end and saying so: the last row and the networks are there.
                finished = curve.last_step == config.steps and folder.model.exists()
                if finished and folder.checkpoint.exists():
                    shutil.rmtree(folder.checkpoint)
            if not finished:
                if trainer is None:
                    check_device(stored.get("device", CPU))
                    import torch

                    torch.set_num_threads(config.threads)  # before it computes anything
                    from rrm.training import jobs

                    trainer = jobs
                with lease.writing():
                    earlier = _healed(folder.provenance, pipe, lambda: provenance.read_provenance(folder))
                products = trainer.choose_products(earlier["products"] if earlier else None)
                facts = provenance.collect(stored, trainer.fingerprint(config), products, given.asked, status.attempt)
                with lease.writing():
                    changes = provenance.record(folder, facts)
                for change in changes:
                    pipe.note(f"differs from the attempt before: {change}")
    except Leave:
        with lease.writing():
            write_status(folder, dataclasses.replace(status, state=RunState.INTERRUPTED, heartbeat=time.time()))
        say(f"--- {RunState.INTERRUPTED} before training began")
        return WorkerExit.STOPPED
    monitor = RunMonitor(lease, status, curve, pipe, stop)
    if not finished:
        assert trainer is not None
        results = {run: Layout(given.results).run(run).path for run in config.requires}
        if stop.requested or not trainer.perform(config, folder.path, monitor, results):
            monitor.close(RunState.INTERRUPTED)
            return WorkerExit.STOPPED
    monitor.close(RunState.DONE)
    return WorkerExit.DONE


def _healed(path: Path, pipe: Pipe, read: Callable[[], _T]) -> _T:
    """What `read` makes of a file. A damaged one is set aside: other files of the run tell the same."""
    try:
        return read()
    except files.DamagedError as error:
        if not path.exists():
            raise
        aside = files.set_aside(path, "corrupt")
        pipe.note(f"{error}; set aside as {aside.name}")
        return read()


def _take_up(folder: RunFolder, before: Status, *, fresh: bool) -> Status:
    """Record that this process owns the run, and remove what it holds if it starts from nothing.

    The wish is written before anything is removed, so that a worker that dies in between leaves no half of a run.
    """
    now = time.time()
    status = dataclasses.replace(
        before, state=RunState.RUNNING, attempt=before.attempt + 1, pid=os.getpid(), host=socket.gethostname(),
        started=now, heartbeat=now, discard=before.discard or fresh, error=None,
    )  # fmt: skip
    write_status(folder, status)
    if not status.discard:
        return status
    for path in folder.trained():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    status = dataclasses.replace(
        status, discard=False, step=0, rows=0, success=None, true_return=None, wall_s=None, steps_per_s=None
    )
    write_status(folder, status)
    return status


def _report(folder: RunFolder, error: Exception, pipe: Pipe, lease: Lease | None = None) -> WorkerExit:
    """Tell the log, the parent and, where the run is owned, its status why the worker leaves."""
    from rrm.errors import RrmError

    if isinstance(error, OSError) and error.errno in files.STORAGE_ERRNOS:
        error = files.storage_error(Path(error.filename or folder.path), error, "read or write")
    code, kind, message = _reason(folder, error)
    reason = RunError(kind=kind, type=type(error).__name__, message=message)
    unforeseen = code is WorkerExit.CRASHED and not isinstance(error, RrmError)
    _log("".join(traceback.format_exception(error)) if unforeseen else f"--- {reason}\n")
    pipe.send(event="error", **dataclasses.asdict(reason))
    if lease is not None:
        # What may not happen again is not the run's end: whether it is tried again, its parent or the next one decides.
        ends = {ErrorKind.REFUSED: RunState.FAILED, ErrorKind.WAITING: RunState.WAITING}
        state = ends.get(kind, RunState.INTERRUPTED)
        try:
            with lease.writing():
                status = dataclasses.replace(read_status(folder), state=state, error=reason, heartbeat=time.time())
                write_status(folder, status)
        except (UserError, LeaseLostError) as problem:
            _log(f"--- the status could not be recorded: {problem}\n")
    return code


def _reason(folder: RunFolder, error: Exception) -> tuple[WorkerExit, ErrorKind, str]:
    from rrm.errors import MissingResultError, RenderingError, RobotError, RrmError, WaitingError

    message = f"{error} ({hint})" if (hint := getattr(error, "hint", None)) else str(error)
    match error:
        case files.StorageError():
            message = f"{error} ({error.todo}, then `{rrmctl('resume', results=folder.results)}` goes on)"
            return WorkerExit.STORAGE, ErrorKind.STORAGE, message
        case WaitingError():
            return WorkerExit.WAITING, ErrorKind.WAITING, str(error)
        case MissingFileError():
            return WorkerExit.MISSING, ErrorKind.MISSING, message
        case files.DamagedError() | MissingResultError():  # others make it again
            return WorkerExit.REFUSED, ErrorKind.DAMAGED, message
        case RenderingError() | RobotError():
            pass  # there was one when the run was planned, and may be again
        case UserError() | RrmError():
            return WorkerExit.REFUSED, ErrorKind.REFUSED, message
    if (told := _card_full(error)) is None:
        kind = ErrorKind.CRASHED
    else:
        kind, remedy = ErrorKind.MEMORY, "fewer runs to a card (--per-gpu), or a smaller agent.batch"
        message = f"the card's memory is full ({told}): {remedy}"
    return WorkerExit.CRASHED, kind, message


def _card_full(error: Exception) -> str | None:
    """What an error says that comes of too little memory on a graphics card; None for all other errors."""
    text = (str(error).splitlines() or [""])[0]
    named = any(kind.__name__ == "OutOfMemoryError" for kind in type(error).__mro__)  # torch need not be loaded
    if named or "CUDA error: out of memory" in text or "_STATUS_ALLOC_FAILED" in text:
        return text.partition(" Of the allocated memory")[0].rstrip(".")  # advice on torch's settings follows
    return None


def _log(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        return  # the log's disk is full as well; the pipe and the exit code still tell


if __name__ == "__main__":
    attend()
    sys.exit(main())
