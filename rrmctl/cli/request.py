"""What the options of `plan` and `run` ask for, and what it will cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rrmctl.cli.options import split_names

if TYPE_CHECKING:
    from rrmctl.planning.cost import CostEstimate
    from rrmctl.planning.plan import Job, Plan
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status
    from rrmctl.store.sweeps import JobRecord


@dataclass(frozen=True)
class Request:
    """An experiment and the options that shape its plan, as typed."""

    name: str
    experiments: Path | None = None
    profile: str | None = None
    seeds: str | None = None
    tasks: list[str] | None = None
    methods: list[str] | None = None
    overrides: list[str] | None = None
    priors: list[str] | None = None

    def plan(self) -> Plan:
        """The jobs; a `UserError` where the experiment is unknown, or an option does not fit it."""
        from rrmctl.planning.experiments import find
        from rrmctl.planning.manifest import load
        from rrmctl.planning.plan import make_plan

        return make_plan(
            load(find(self.name, self.experiments)),
            profile=self.profile,
            seeds=self.seeds,
            tasks=split_names(self.tasks),
            methods=split_names(self.methods),
            overrides=self.overrides or [],
            priors=self.priors or [],
        )


@dataclass(frozen=True)
class Forecast:
    """A plan, where each of its runs stands, and what is left to pay."""

    plan: Plan
    states: Mapping[str, Status]  #: by job id
    cost: CostEstimate

    def count(self, state: str) -> int:
        """Jobs in this state."""
        return sum(status.state == state for status in self.states.values())

    @property
    def shares(self) -> dict[str, float]:
        """Share of each job that is still to be run."""
        return {
            job: 0.0 if status.state == "done" else 1.0 - status.step / status.steps if status.steps else 1.0
            for job, status in self.states.items()
        }

    @property
    def hours_left(self) -> float:
        """Core-hours still to be paid."""
        return self.cost.core_hours(self.shares)


def forecast(plan: Plan, layout: Layout) -> Forecast:
    """What the plan will cost, given what the store already has and how fast it came about."""
    from rrmctl.planning.cost import estimate_cost
    from rrmctl.store.reader import statuses
    from rrmctl.store.speeds import stored_speeds

    states = statuses(layout, plan.everything)
    return Forecast(plan, states, estimate_cost(plan, stored_speeds(layout, states)))


def job_record(job: Job) -> JobRecord:
    """A job as the store records it."""
    from rrmctl.store.sweeps import JobRecord

    return JobRecord(
        id=job.id, cell=job.config.cell, **job.row._asdict(), seed=job.seed, steps=job.config.steps,
        requires=job.requires,
    )  # fmt: skip


def duration(hours: float) -> str:
    """Hours in the unit that suits them: `40 s`, `12 min`, `3.5 h`, `94 h`, `12 days`."""
    seconds = hours * 3600
    if seconds < 90:
        return f"{seconds:.0f} s"
    if hours < 1.5:
        return f"{seconds / 60:.0f} min"
    if hours < 10:
        return f"{hours:.1f} h"
    return f"{hours:.0f} h" if hours < 200 else f"{hours / 24:.0f} days"
