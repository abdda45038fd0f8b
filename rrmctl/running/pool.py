"""Supervised child processes: one per job, each in its own process group, none able to take another down.

The parent waits for pipes and exit codes only. It handles SIGINT and SIGTERM while it runs: the first asks every
worker to checkpoint and leave, the second ends them at once.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from rrmctl.errors import Exit, UserError
from rrmctl.running.child import WORKER, Child
from rrmctl.running.scheduler import Ending, Outcome, Phase, Scheduler
from rrmctl.store.atomic import StorageError
from rrmctl.store.layout import Layout
from rrmctl.store.owner import LEASE_S, Beat, Watch, is_owned
from rrmctl.store.reader import blocked_by, run_status
from rrmctl.store.records import ErrorKind, RunError, State, Status, record_failure
from rrmctl.waking import WakingTime

#: Longest wait between two looks at the children, seconds; pipes and signals end it early.
_TICK_S = 0.2

#: How often in a row the system may refuse to start a process, with growing pauses: for some minutes.
_REFUSALS = 8

#: Time between two looks at runs that other processes own, seconds.
_POLL_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """A run the pool should see to its end."""

    id: str
    label: str  #: for people
    steps: int = 0  #: of the whole run
    threads: int = 1
    attempt: int = 0  #: of its status when the command was given; a higher one later was somebody else's
    fresh: bool = False  #: remove what the run holds and start from nothing
    requires: Sequence[str] = ()  #: runs that must be done before it


class Watcher(Protocol):
    """Who is told what happens; see `rrmctl.cli.live`."""

    def started(self, job: str, attempt: int) -> None:
        """A worker took the run up."""

    def beat(self, job: str, step: int, steps_per_s: float | None) -> None:
        """Progress in environment steps."""

    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None:
        """An evaluation."""

    def note(self, job: str, text: str) -> None:
        """Something a person should read."""

    def ended(self, job: str, outcome: Outcome, phase: Phase) -> None:
        """An attempt ended; `phase` says what becomes of the job."""

    def stopping(self, workers: int, wait_s: float) -> None:
        """Workers were asked to checkpoint and leave."""

    def tick(self) -> None:
        """Called several times a second."""


@dataclass(kw_only=True)
class Pool:
    """Runs assignments, `slots` at a time."""

    layout: Layout
    assignments: Sequence[Assignment]
    slots: int
    watcher: Watcher
    retries: int = 2
    hang_after_s: float = 1800.0  #: silence after which a worker counts as hung; a feedback session may take minutes
    lease_s: float = LEASE_S  #: silence after which the runs of other processes are taken over
    stop_after_s: float = 60.0  #: time a worker has to checkpoint and leave
    memory_limit: int | None = None  #: bytes that a worker may take; None: as much as there is
    asked: Sequence[str] = ()  #: the command, for the runs' provenance
    command: Sequence[str] = WORKER
    _children: dict[str, Child] = field(default_factory=dict, init=False)
    _launched: set[str] = field(default_factory=set, init=False)
    _waking: WakingTime = field(default_factory=WakingTime, init=False)
    _signals: int = field(default=0, init=False)
    _kill_at: float | None = field(default=None, init=False)  #: when workers that were asked to leave are ended
    _silent: dict[str, Beat] = field(default_factory=dict, init=False)  #: runs to be taken over
    _weighed: float = field(default=0.0, init=False)  #: when the memory of workers was last looked at
    _refusals: int = field(default=0, init=False)  #: of the system to start a process, in a row
    _start_at: float = field(default=0.0, init=False)  #: before this moment nothing is started
    _looked: float = field(default=0.0, init=False)  #: when runs of other processes were last looked at

    def __post_init__(self) -> None:
        self._jobs = {assignment.id: assignment for assignment in self.assignments}
        self._selector = selectors.DefaultSelector()
        self._watch = Watch(self.lease_s, self._waking)
        requires = {assignment.id: assignment.requires for assignment in self.assignments if assignment.requires}
        self.scheduler = Scheduler(self._jobs, slots=self.slots, retries=self.retries, requires=requires)

    def run(self) -> Exit:
        """See every job to its end, or to a good place to stop.

        Returns:
            `DONE`, `FAILED`, `INCOMPLETE`, or `INTERRUPTED` after a second signal.
        """
        with _signals_to(self._on_signal) as wakeup:
            self._selector.register(wakeup, selectors.EVENT_READ)
            try:
                while not self.scheduler.finished:
                    self._look_elsewhere()
                    self._start_waiting()
                    self._listen(wakeup)
                    self._end_misbehaving()
                    self._obey()
                    self._reap()
                    self.watcher.tick()
                    if self._signals > 1:
                        return Exit.INTERRUPTED
                return self.scheduler.exit_code()
            finally:
                self._kill_all()
                self._selector.close()

    def _start_waiting(self) -> None:
        if time.monotonic() < self._start_at:
            return
        while (job := self.scheduler.next()) is not None:
            assignment, status = self._jobs[job], run_status(self.layout.run(job))
            settled = None if job in self._launched else _settled(assignment, status)
            if status.state is State.RUNNING and job not in self._silent:
                settled = Outcome(Ending.ELSEWHERE)
            if settled is not None:
                self._conclude(job, settled)
                continue
            self.scheduler.start(job)
            try:
                self._launch(assignment)
            except StorageError as error:
                self._conclude(job, _failure(ErrorKind.STORAGE, "StorageError", str(error)))
            except OSError as error:
                self._wait_for_the_system(job, error)
                return
            self._refusals = 0

    def _wait_for_the_system(self, job: str, error: OSError) -> None:
        """It started no process, for want of memory or of numbers for it: that may pass."""
        self.scheduler.free(job)
        self._refusals += 1
        if self._refusals > _REFUSALS and not self._children:
            self.watcher.note(job, f"no process can be started: {error.strerror}; giving up for now")
            self.scheduler.stop()
            return
        pause = 2.0 ** min(self._refusals - 1, 6)
        self.watcher.note(job, f"no process can be started: {error.strerror}; trying again in {pause:.0f} s")
        self._start_at = time.monotonic() + pause

    def _launch(self, assignment: Assignment) -> None:
        options = ["--asked", json.dumps(list(self.asked))]
        if assignment.fresh:
            options += ["--fresh", str(assignment.attempt)]
        if (beat := self._silent.pop(assignment.id, None)) is not None:
            options += ["--take-over", f"{beat.owner}:{beat.count}"]
        child = Child(
            self.layout, assignment.id, threads=assignment.threads, options=options, command=self.command,
            clock=self._waking,
        )  # fmt: skip
        self._children[assignment.id] = child
        self._launched.add(assignment.id)
        self._selector.register(child, selectors.EVENT_READ)

    def _look_elsewhere(self) -> None:
        """Take over runs that other processes gave up, and take note of those they finished."""
        if not self.scheduler.elsewhere or time.monotonic() - self._looked < _POLL_S:
            return
        self._looked = time.monotonic()
        for job in self.scheduler.elsewhere:
            folder = self.layout.run(job)
            settled = _settled(self._jobs[job], run_status(folder))
            if settled is not None:
                self._conclude(job, settled)
            elif is_owned(folder):
                self._take_over(job)
            else:
                self.scheduler.free(job)

    def _take_over(self, job: str) -> None:
        """Queue a run whose owner gives no sign of life any more: each time that a lease has passed."""
        beat = self._watch.expired(self.layout.run(job))
        if beat is not None:
            self.watcher.note(job, f"its owner gave no sign of life for {self.lease_s:g} s; trying to take it over")
            self._silent[job] = beat
            self.scheduler.free(job)

    def _listen(self, wakeup: int) -> None:
        for key, _ in self._selector.select(_TICK_S):
            if isinstance(key.fileobj, Child):
                self._hear(key.fileobj)
            else:
                os.read(wakeup, 4096)

    def _hear(self, child: Child) -> None:
        messages = child.messages()
        if not child.open and child in self._selector.get_map():
            self._selector.unregister(child)
        for message in messages:
            self._pass_on(child, message)

    def _pass_on(self, child: Child, message: Mapping[str, Any]) -> None:
        job, watcher = child.job, self.watcher
        match message["event"]:
            case "start":
                self.scheduler.resumed(job, message["rows"])
                watcher.started(job, message["attempt"])
            case "beat":
                watcher.beat(job, message["step"], message["steps_per_s"])
            case "row":
                watcher.row(job, message["step"], message["success"], message["true_return"])
            case "note":
                watcher.note(job, message["text"])
            case "error":
                child.error = RunError.from_json(message)

    def _end_misbehaving(self) -> None:
        """End workers that are silent for too long, and those that take too much memory."""
        lived, now = self._waking(), time.monotonic()
        for child in self._children.values():
            if lived - child.heard > self.hang_after_s:
                child.end(ErrorKind.HUNG, "gave no sign of life")
        if self.memory_limit is None or now - self._weighed < _POLL_S:
            return
        self._weighed = now
        for child in self._children.values():
            memory = child.memory()
            if memory is not None and memory > self.memory_limit:
                taken, limit = (f"{each / 2**30:.2f} GiB" for each in (memory, self.memory_limit))
                child.end(ErrorKind.MEMORY, f"took {taken} of memory, {limit} are allowed,")

    def _on_signal(self) -> None:
        self._signals += 1

    def _obey(self) -> None:
        """Act on signals that have arrived, outside their handlers; and on workers that take too long to leave."""
        if self._signals and self._kill_at is None:
            self.scheduler.stop()
            self._kill_at = self._waking() + self.stop_after_s
            self.watcher.stopping(len(self._children), self.stop_after_s)
            for child in self._children.values():
                child.ask_to_stop()
        if self._kill_at is not None and self._waking() > self._kill_at:
            for child in self._children.values():
                child.kill()

    def _reap(self) -> None:
        for child in [child for child in self._children.values() if child.ended()]:
            self._hear(child)
            self._forget(child)
            self._conclude(child.job, self._outcome(child))

    def _outcome(self, child: Child) -> Outcome:
        """How an attempt ended. Some library may end the process with exit code 0: only the status says done."""
        outcome = child.outcome(stopping=self._kill_at is not None)
        if outcome.ending is Ending.DONE and run_status(self.layout.run(child.job)).state is not State.DONE:
            return _failure(ErrorKind.CRASHED, "Exit", "left with exit code 0 before its end")
        return outcome

    def _conclude(self, job: str, outcome: Outcome) -> None:
        phase = self.scheduler.end(job, outcome)
        if phase is Phase.FAILED and outcome.error is not None:
            try:
                record_failure(self.layout.run(job), outcome.error)
            except UserError as error:
                self.watcher.note(job, f"its failure could not be recorded: {error}")
        self.watcher.ended(job, outcome, phase)
        if phase is Phase.FAILED:
            for blocked in self.scheduler.block(job):
                self.watcher.ended(blocked, Outcome(Ending.BLOCKED, blocked_by(job, outcome.error)), Phase.BLOCKED)

    def _forget(self, child: Child) -> None:
        if child.open:
            self._selector.unregister(child)
            child.close()
        del self._children[child.job]

    def _kill_all(self) -> None:
        for child in self._children.values():
            child.kill()
        for child in list(self._children.values()):
            child.wait()
        self._children.clear()


def _settled(assignment: Assignment, status: Status) -> Outcome | None:
    """How a run ended in another process' hands since the command was given; None if there is work left."""
    if status.attempt <= assignment.attempt:
        return None
    if status.state is State.DONE:
        return Outcome(Ending.DONE)
    if status.state is State.FAILED:
        return Outcome(Ending.FAILED, status.error)
    return None


def _failure(kind: ErrorKind, name: str, message: str) -> Outcome:
    return Outcome(Ending.FAILED, RunError(kind=kind, type=name, message=message))


@contextlib.contextmanager
def _signals_to(handler: Callable[[], None]) -> Iterator[int]:
    """Call `handler` on SIGINT and SIGTERM; gives a descriptor that becomes readable then. Main thread only."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    os.set_blocking(writing, False)
    before: dict[signal.Signals, Any] = {}
    woken = -1
    if threading.current_thread() is threading.main_thread():  # Python allows handlers nowhere else
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda _number, _frame: handler())
        woken = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    try:
        yield reading
    finally:
        if before:
            signal.set_wakeup_fd(woken)
        for number, old in before.items():
            signal.signal(number, old)
        os.close(reading)
        os.close(writing)
