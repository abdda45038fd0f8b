"""The supervisor: sees every job of a command to its end, whoever runs it.

It handles SIGINT and SIGTERM while it runs: the first asks every worker to checkpoint and leave; a SIGINT after it ends
them at once, unless the supervisor is `patient`. Programs send SIGTERM, and may do so again.
"""

from __future__ import annotations

import contextlib
import json
import signal
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rrmctl.errors import Exit, UserError
from rrmctl.running.executor import Ended, Evaluated, Event, Executor, Note, Progress, Started, WorkOrder
from rrmctl.running.scheduler import Outcome, Scheduler, Stage
from rrmctl.store.files import StorageError
from rrmctl.store.labels import OpenSession, published, waits_for
from rrmctl.store.layout import Layout
from rrmctl.store.owner import Beat, Watch, is_owned, lease_s
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, blocked_by, record_failure, run_status
from rrmctl.store.sweeps import Job
from rrmctl.suspend_clock import WakingTime

#: Longest wait between two looks at what there is to do, seconds.
_TICK_S = 0.2

#: How often in a row the system may refuse to start a process, with growing pauses: for some minutes.
_REFUSALS = 8

#: Time between two looks at runs that other processes own, seconds.
_POLL_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Terms:
    """How one of the jobs is to be run."""

    threads: int = 1
    attempt: int = 0  #: of its status when the command was given; a higher one later was somebody else's
    fresh: bool = False  #: remove what the run holds and start from nothing


class Watcher(Protocol):
    """Who is told what happens; see `rrmctl.cli.live`."""

    def started(self, job: str, attempt: int) -> None: ...  #: a worker took the run up
    def beat(self, job: str, step: int, steps_per_s: float | None) -> None: ...  #: environment steps
    def row(self, job: str, step: int, success: float | None, true_return: float | None) -> None: ...  #: an evaluation
    def note(self, job: str, text: str) -> None: ...  #: something a person should read
    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None: ...  #: an attempt; `phase`: of the job from now
    def stopping(self, workers: int, wait_s: float) -> None: ...  #: they were asked to checkpoint and leave
    def asked(self, sessions: Sequence[OpenSession]) -> None: ...  #: what runs wait for, about once a second
    def tick(self) -> None: ...  #: several times a second


@dataclass(kw_only=True)
class Supervisor:
    """Runs jobs, `slots` at a time."""

    layout: Layout
    jobs: Sequence[Job]
    slots: int
    watcher: Watcher
    executor: Executor
    terms: Mapping[str, Terms] = field(default_factory=dict)  #: by id; where they are not the usual ones
    on_cards: Collection[str] = ()  #: ids of those that wait for a place on a graphics card
    places: int = 0  #: so many of those at a time
    retries: int = 2
    lease_s: float | None = (
        None  #: silence after which the runs of other processes are taken over; None: as usual there
    )
    stop_after_s: float = 60.0  #: time a worker has to checkpoint and leave
    asked: Sequence[str] = ()  #: the command, for the runs' provenance
    signals: list[int] = field(default_factory=list)  #: that have arrived; handlers of others may add theirs
    patient: bool = False  #: the workers have the whole time to leave, however often they are asked
    _launched: set[str] = field(default_factory=set, init=False)
    _waking: WakingTime = field(default_factory=WakingTime, init=False)
    _kill_at: float | None = field(default=None, init=False)  #: when workers that were asked to leave are ended
    _silent: dict[str, Beat] = field(default_factory=dict, init=False)  #: runs to be taken over
    _refusals: int = field(default=0, init=False)  #: of the system to start a process, in a row
    _start_at: float = field(default=0.0, init=False)  #: before this moment nothing is started
    _asked: dict[str, OpenSession] = field(default_factory=dict, init=False)  #: what people are asked, by run
    _looked: float = field(default=0.0, init=False)  #: when runs of other processes were last looked at

    def __post_init__(self) -> None:
        self._terms = {job.id: self.terms.get(job.id, Terms()) for job in self.jobs}
        self._lease_s = lease_s(self.layout.root) if self.lease_s is None else self.lease_s
        self._watch = Watch(self._lease_s, self._waking)
        requires = {job.id: job.requires for job in self.jobs if job.requires}
        self.scheduler = Scheduler(
            self._terms,
            slots=self.slots,
            retries=self.retries,
            requires=requires,
            on_cards=self.on_cards,
            places=self.places,
        )

    def run(self) -> Exit:
        """See every job to its end, or to a good place to stop; `INTERRUPTED` where it was ended at once."""

        def take(number: int, _frame: object) -> None:
            self.signals.append(number)

        with contextlib.ExitStack() as afterwards:
            if threading.current_thread() is threading.main_thread():  # Python allows handlers nowhere else
                for number in (signal.SIGINT, signal.SIGTERM):
                    afterwards.callback(signal.signal, number, signal.signal(number, take))
            afterwards.callback(self.executor.close)
            while not self.scheduler.finished:
                self._look_elsewhere()
                self._start_waiting()
                for event in self.executor.events(_TICK_S):
                    self._heed(event)
                self._obey()
                self.watcher.tick()
                if signal.SIGINT in self.signals[1:] and not self.patient:
                    return Exit.INTERRUPTED
            return self.scheduler.exit_code()

    def _start_waiting(self) -> None:
        if time.monotonic() < self._start_at:
            return
        while (job := self.scheduler.next()) is not None:
            status = run_status(self.layout.run(job))
            settled = None if job in self._launched else self._settled(job, status)
            if status.state is RunState.RUNNING and job not in self._silent:
                settled = Outcome(Stage.ELSEWHERE)
            elif (job in self._launched or not self._terms[job].fresh) and self._asks_people(job, status):
                settled = Outcome(Stage.ELSEWHERE, status.error)
            if settled is not None:
                self._conclude(job, settled)
                continue
            self.scheduler.start(job)
            terms, options = self._terms[job], ["--asked", json.dumps(list(self.asked))]
            if terms.fresh:
                options += ["--fresh", str(terms.attempt)]
            if (beat := self._silent.pop(job, None)) is not None:
                options += ["--take-over", f"{beat.owner}:{beat.count}"]
            try:
                self.executor.submit(WorkOrder(run=job, threads=terms.threads, options=tuple(options)))
            except StorageError as error:
                self._conclude(job, _failure(ErrorKind.STORAGE, "StorageError", str(error)))
            except OSError as error:
                self._wait_for_the_system(job, error)
                return
            self._launched.add(job)
            self._refusals = 0

    def _wait_for_the_system(self, job: str, error: OSError) -> None:
        """It started no process, for want of memory or of numbers for it: that may pass."""
        self.scheduler.free(job)
        self._refusals += 1
        if self._refusals > _REFUSALS and not self.executor.running:
            self.watcher.note(job, f"no process can be started: {error.strerror}; giving up for now")
            self.scheduler.stop()
            return
        pause = 2.0 ** min(self._refusals - 1, 6)
        self.watcher.note(job, f"no process can be started: {error.strerror}; trying again in {pause:.0f} s")
        self._start_at = time.monotonic() + pause

    def _look_elsewhere(self) -> None:
        """Take over runs that other processes gave up, or whose questions are answered; note those that are done."""
        if not self.scheduler.elsewhere or time.monotonic() - self._looked < _POLL_S:
            return
        self._looked = time.monotonic()
        for job in self.scheduler.elsewhere:
            folder = self.layout.run(job)
            status = run_status(folder)
            settled = self._settled(job, status)
            if settled is not None:
                self._conclude(job, settled)
            elif not is_owned(folder):
                if not self._asks_people(job, status):
                    self.scheduler.free(job)
            elif (beat := self._watch.expired(folder)) is not None:  # each time that a lease has passed
                self.watcher.note(
                    job, f"its owner gave no sign of life for {self._lease_s:g} s; trying to take it over"
                )
                self._silent[job] = beat
                self.scheduler.free(job)
        self.watcher.asked([self._asked[job] for job in self.scheduler.elsewhere if job in self._asked])

    def _asks_people(self, job: str, status: Status) -> bool:
        """Whether the run waits for answers of people that are not all there yet."""
        self._asked.pop(job, None)
        session = waits_for(self.layout.run(job), status)
        if session is not None:
            self._asked[job] = session
        return session is not None

    def _settled(self, job: str, status: Status) -> Outcome | None:
        """How a run ended in another process' hands since the command was given; None if there is work left."""
        if status.attempt <= self._terms[job].attempt:
            return None
        if status.state is RunState.DONE:
            return Outcome(Stage.DONE)
        return Outcome(Stage.FAILED, status.error) if status.state is RunState.FAILED else None

    def _heed(self, event: Event) -> None:
        match event:
            case Started():
                self.scheduler.resumed(event.run, event.rows)
                self.watcher.started(event.run, event.attempt)
            case Progress():
                self.watcher.beat(*event)
            case Evaluated():
                self.watcher.row(*event)
            case Note():
                self.watcher.note(*event)
            case Ended(run, outcome):
                # Some library may end the process with exit code 0: only the status says done.
                folder = self.layout.run(run)
                if outcome.ending is Stage.DONE and run_status(folder).state is not RunState.DONE:
                    outcome = _failure(ErrorKind.CRASHED, "Exit", "left with exit code 0 before its end")
                if outcome.error is not None and outcome.error.kind is ErrorKind.WAITING and published(folder):
                    outcome = Outcome(Stage.ELSEWHERE, outcome.error)  # for people: it will be free again
                self._conclude(run, outcome)

    def _obey(self) -> None:
        """Act on signals that have arrived, outside their handlers; and on workers that take too long to leave."""
        if self.signals and self._kill_at is None:
            self.scheduler.stop()
            self._kill_at = self._waking() + self.stop_after_s
            self.watcher.stopping(self.executor.running, self.stop_after_s)
            self.executor.stop()
        if self._kill_at is not None and self._waking() > self._kill_at:
            self.executor.stop(now=True)

    def _conclude(self, job: str, outcome: Outcome) -> None:
        broken = self.scheduler.broken
        phase = self.scheduler.end(job, outcome)
        if self.scheduler.broken and not broken:
            self.watcher.note(
                job, "workers end before they take a run up, whichever it is: nothing is started any more"
            )
        if phase is Stage.FAILED and outcome.error is not None:
            try:
                record_failure(self.layout.run(job), outcome.error)
            except UserError as error:
                self.watcher.note(job, f"its failure could not be recorded: {error}")
        self.watcher.ended(job, outcome, phase)
        if phase is Stage.FAILED:
            for blocked in self.scheduler.block(job):
                self.watcher.ended(blocked, Outcome(Stage.BLOCKED, blocked_by(job, outcome.error)), Stage.BLOCKED)


def _failure(kind: ErrorKind, name: str, message: str) -> Outcome:
    return Outcome(Stage.FAILED, RunError(kind=kind, type=name, message=message))
