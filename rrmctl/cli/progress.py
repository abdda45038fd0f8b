"""How far groups of runs are, and how long the rest takes at the speed seen so far. Pure."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from rrmctl.cli.request import duration
from rrmctl.commands import rrmctl

if TYPE_CHECKING:
    from pathlib import Path

    from rrmctl.store.labels import OpenSession
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import Job, SweepRecord

#: States in the order in which they are shown.
STATES = ("done", "running", "interrupted", "waiting", "queued", "failed", "blocked", "unreadable")

#: States in which nothing is left to be done, or can be.
OVER = ("done", "failed", "blocked")


@dataclass(frozen=True)
class Group:
    """Runs that are shown on one line."""

    name: str  #: what they have in common
    jobs: Sequence[Job]
    states: Mapping[str, Status]  #: of every job, by id
    rates: Mapping[tuple[str, str], float] | None = None  #: steps/s by task and method; default: the group's own
    heading: str = ""  #: what kind of thing `name` is

    @cached_property
    def counts(self) -> Counter[str]:
        """Runs by state."""
        return Counter(str(self.states[job.id].state) for job in self.jobs)

    @property
    def open(self) -> int:
        """Runs that are neither done nor failed, nor blocked by one that failed."""
        return len(self.jobs) - sum(self.counts[state] for state in OVER)

    @cached_property
    def seconds_left(self) -> float | None:
        """Seconds of one core that the open runs still take; None where nothing like one of them has run yet."""
        from rrmctl.store.status import speeds

        rates = speeds(self.jobs, self.states) if self.rates is None else self.rates
        left = [(job, self.states[job.id]) for job in self.jobs if self.states[job.id].state not in OVER]
        if any((job.task, job.method) not in rates for job, _ in left):
            return None
        return sum(((job.steps - status.step) / rates[job.task, job.method] for job, status in left), 0.0)

    @property
    def left(self) -> str:
        """Time left, in words: that of the workers while some run, else that of one core; empty where unknown."""
        if not self.open or self.seconds_left is None:
            return ""
        running, hours = self.counts["running"], self.seconds_left / 3600
        return duration(hours / running) if running else f"{duration(hours)} of one core"

    def as_json(self) -> dict[str, Any]:
        counts = {state: self.counts[state] for state in STATES}
        return {"name": self.name, "runs": len(self.jobs), **counts, "core_seconds_left": self.seconds_left}


def group_by_sweep(sweeps: Iterable[SweepRecord], states: Mapping[str, Status]) -> list[Group]:
    """One group for each variant of each experiment."""
    once = {f"{sweep.experiment} ({sweep.variant})": {job.id: job for job in sweep.everything} for sweep in sweeps}
    return [Group(name, list(jobs.values()), states, heading="experiment") for name, jobs in once.items()]


def group_by_row(sweeps: Iterable[SweepRecord], states: Mapping[str, Status]) -> list[Group]:
    """One group for each row of the grid of each variant: all seeds of it."""
    from rrmctl.store.status import speeds

    groups = []
    for sweep in sweeps:
        rates = speeds(sweep.everything, states)
        rows: defaultdict[tuple[str, ...], list[Job]] = defaultdict(list)
        for job in sweep.everything:
            rows[sweep.variant, *job.row.words].append(job)
        groups += [Group("  ".join(names), jobs, states, rates, "row") for names, jobs in rows.items()]
    return groups


def errors(jobs: Iterable[Job], states: Mapping[str, Status]) -> dict[str, list[Job]]:
    """Failed, blocked and unreadable runs by what went wrong, the most frequent first."""
    stopped: defaultdict[str, list[Job]] = defaultdict(list)
    for job in jobs:
        status = states[job.id]
        if status.state in ("failed", "blocked", "unreadable"):
            stopped[str(status.error or "no reason was recorded")].append(job)
    return dict(sorted(stopped.items(), key=lambda item: -len(item[1])))


def awaited(sessions: Iterable[OpenSession], experiment_of: Mapping[str, str], results: str | Path) -> list[str]:
    """What people are waited for, a line an experiment, with the command that asks them.

    Args: experiment_of: the experiment of each run.
    """
    by_experiment: defaultdict[str, list[OpenSession]] = defaultdict(list)
    for session in sessions:
        by_experiment[experiment_of[session.run]].append(session)
    lines = []
    for name, open_ in by_experiment.items():
        who = f"{runs(len(open_))} wait{'s' if len(open_) == 1 else ''}"
        missing = sum(session.missing for session in open_)
        what = f"for {missing:,} answer{'s' if missing != 1 else ''}" if missing else "until no answer can be undone"
        lines.append(f"{who} {what}: {rrmctl('label', name, results=results)}")
    return lines


def experiments(sweeps: Iterable[SweepRecord]) -> dict[str, str]:
    """The name of one experiment for each run."""
    return {job.id: sweep.experiment for sweep in sweeps for job in sweep.everything}


def runs(count: int) -> str:
    """`1 run`, `2 runs`."""
    return f"{count} run{'s' if count != 1 else ''}"
