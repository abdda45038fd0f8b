"""Which job may start, which is tried again and when all is over: a state machine without processes or clocks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from rrmctl.errors import Exit
from rrmctl.store.status import ErrorKind, RunError


class Stage(StrEnum):
    """Where a job stands in this process' eyes; the last five are also how an attempt can end."""

    WAITING = "waiting"
    RUNNING = "running"
    ELSEWHERE = "elsewhere"  #: another process owns it, or people are asked; it will be done, or free again
    DONE = "done"
    FAILED = "failed"  #: see the error
    STOPPED = "stopped"  #: left in good order before its end; a later command goes on with it
    BLOCKED = "blocked"  #: one that it needs has failed


@dataclass(frozen=True)
class Outcome:
    """The end of one attempt."""

    ending: Stage
    error: RunError | None = None  #: of one that failed or is blocked
    stillborn: bool = False  #: its worker crashed before it took the run up


#: Failures worth another attempt. The others would fail again in the same way.
RETRIED = frozenset({ErrorKind.CRASHED, ErrorKind.KILLED, ErrorKind.HUNG, ErrorKind.MEMORY})

#: So many times as often is a job tried again that somebody killed: that is not its fault.
KILLED_RETRIES = 50

#: After so many jobs in a row whose workers crashed before they took them up nothing starts any more: the program
#: itself is broken, and would use up the attempts of all others within minutes.
STILLBORN = 3


class Scheduler:
    """The jobs of one command.

    Args:
        jobs: their ids, in the order in which they should start.
        slots: how many may run at a time.
        retries: how often a job that crashed is tried again without a further evaluation in between.
        requires: for jobs that need others, which; those that are none of `jobs` count as done.
        on_cards: those that need a place on a graphics card.
        places: how many of those may run at a time.
    """

    def __init__(
        self,
        jobs: Iterable[str],
        *,
        slots: int,
        retries: int = 2,
        requires: Mapping[str, Collection[str]] = MappingProxyType({}),
        on_cards: Collection[str] = (),
        places: int = 0,
    ) -> None:
        self._queue: deque[str] = deque(jobs)
        self._stages = dict.fromkeys(self._queue, Stage.WAITING)
        self._requires = {job: [run for run in needed if run in self._stages] for job, needed in requires.items()}
        self._slots = slots
        self._on_cards = frozenset(on_cards)
        self._places = places
        self._retries = retries
        self._crashes: Counter[str] = Counter()
        self._kills: Counter[str] = Counter()
        self._stillborn: set[str] = set()  # jobs, since the last that was taken up
        self._rows: dict[str, int] = {}
        self._running: set[str] = set()
        self._elsewhere: set[str] = set()
        self.stopping = False  #: nothing starts any more
        self.broken = False  #: for workers end before they begin

    def next(self) -> str | None:
        """The job that may start now; None while every slot is taken or nothing waits but for others, or for cards."""
        if self.stopping or len(self._running) >= self._slots:
            return None
        full = len(self._running & self._on_cards) >= self._places
        return next((job for job in self._queue if self._ready(job) and not (full and job in self._on_cards)), None)

    def _ready(self, job: str) -> bool:
        return all(self._stages[needed] is Stage.DONE for needed in self._requires.get(job, ()))

    def start(self, job: str) -> None:
        """The job `next` named is running."""
        self._queue.remove(job)
        self._running.add(job)
        self._stages[job] = Stage.RUNNING

    def resumed(self, job: str, rows: int) -> None:
        """The attempt began with so many evaluations; more than the one before it forgives earlier crashes."""
        self._stillborn.clear()
        if rows > self._rows.get(job, 0):
            self._crashes[job] = self._kills[job] = 0
        self._rows[job] = rows

    def end(self, job: str, outcome: Outcome) -> Stage:
        """An attempt ended: a running one, one that ran elsewhere, or one that need not start at all.

        Returns:
            The job's new stage; `waiting` means that it will be tried again.
        """
        stage = outcome.ending
        if stage is Stage.FAILED and job in self._running:  # elsewhere it was tried as often as it should be
            stage = self._after_failure(job, outcome)
        self._leave(job)
        self._stages[job] = stage
        if stage is Stage.WAITING:
            self._queue.append(job)  # behind the others: what crashed one job may be gone by then
        elif stage is Stage.ELSEWHERE:
            self._elsewhere.add(job)
        return stage

    def _after_failure(self, job: str, outcome: Outcome) -> Stage:
        error = outcome.error
        assert error is not None  # a failure says why
        if error.kind is ErrorKind.STORAGE:
            self.stop()  # whatever starts next would meet the same folder
        if error.kind in (ErrorKind.STORAGE, ErrorKind.MISSING, ErrorKind.WAITING):
            return Stage.STOPPED  # others may have what they need
        if error.kind not in RETRIED:
            return Stage.FAILED
        if outcome.stillborn:
            self._stillborn.add(job)
            if len(self._stillborn) >= STILLBORN:
                self.broken = True
                self.stop()
                return Stage.STOPPED
        killed = error.kind is ErrorKind.KILLED
        count, most = (self._kills, KILLED_RETRIES * self._retries) if killed else (self._crashes, self._retries)
        count[job] += 1
        return Stage.FAILED if count[job] > most else Stage.WAITING

    def _leave(self, job: str) -> None:
        for place in (self._running, self._elsewhere, self._queue):
            if job in place:
                place.remove(job)
                return
        raise ValueError(f"job {job} has ended already")

    def block(self, failed: str) -> list[str]:
        """The jobs that can no longer start since this one failed, those that need them included."""
        blocked = [job for job in self._queue if failed in self._requires.get(job, ())]
        for job in blocked:
            self._queue.remove(job)
            self._stages[job] = Stage.BLOCKED
        return blocked + [further for job in blocked for further in self.block(job)]

    def free(self, job: str) -> None:
        """A job that ran elsewhere was given up there or has its answers, or could not be started: it is next."""
        self._leave(job)
        self._stages[job] = Stage.WAITING
        self._queue.appendleft(job)

    def stop(self) -> None:
        """Start nothing any more."""
        self.stopping = True

    @property
    def finished(self) -> bool:
        """True when there is nothing left to wait for."""
        if self._running:
            return False
        return self.stopping or not (self._elsewhere or any(map(self._ready, self._queue)))

    @property
    def elsewhere(self) -> list[str]:
        """Jobs that other processes own, or that people are asked for."""
        return sorted(self._elsewhere)

    def counts(self) -> Counter[Stage]:
        """Jobs by stage."""
        return Counter(self._stages.values())

    def exit_code(self) -> Exit:
        """What the command leaves with: incomplete while there is more to do, else failed if anything failed."""
        counts = self.counts()
        if counts[Stage.DONE] + counts[Stage.FAILED] + counts[Stage.BLOCKED] < len(self._stages):
            return Exit.INCOMPLETE
        return Exit.FAILED if counts[Stage.FAILED] else Exit.DONE
