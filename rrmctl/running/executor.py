"""Who runs the jobs that a supervisor schedules: processes here, a queue, other machines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from rrmctl.running.scheduler import Outcome


@dataclass(frozen=True, kw_only=True)
class WorkOrder:
    """One attempt at a run."""

    run: str  #: its id
    threads: int  #: it may use
    options: tuple[str, ...] = ()  #: further arguments of the worker


class Started(NamedTuple):
    """A worker took the run up."""

    run: str
    attempt: int
    rows: int  #: evaluations it begins with


class Progress(NamedTuple):
    """A sign of life, in environment steps."""

    run: str
    step: int
    steps_per_s: float | None


class Evaluated(NamedTuple):
    """An evaluation."""

    run: str
    step: int
    success: float | None
    true_return: float | None


class Note(NamedTuple):
    """Something a person should read."""

    run: str
    text: str


class Ended(NamedTuple):
    """An attempt ended."""

    run: str
    outcome: Outcome


Event = Started | Progress | Evaluated | Note | Ended


class Executor(Protocol):
    """Takes orders and tells what becomes of them; knows nothing of retries, or of runs that need others."""

    def submit(self, order: WorkOrder) -> None:
        """Begin an attempt. Raises StorageError, or OSError where nothing can be begun just now."""

    def events(self, wait_s: float) -> Iterator[Event]:
        """What has happened since the last call; waits so long at the most where nothing has."""

    @property
    def running(self) -> int:
        """Attempts that have not ended."""

    def stop(self, *, now: bool = False) -> None:
        """Have every worker checkpoint and leave; or end it `now`. Their ends come as events."""

    def close(self) -> None:
        """End what is left, and wait for it."""
