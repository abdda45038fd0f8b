"""What the options of `plan` and `run` ask for, and what it will cost, in the same words for both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rrmctl.cli.options import split_names
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrmctl.planning.cost import CostEstimate
    from rrmctl.planning.plan import Plan
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status


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
        """The jobs.

        Raises:
            UserError: the experiment is unknown, or an option does not fit it.
        """
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

    def left(self, job: str) -> float:
        """Share of a job that is still to be run."""
        status = self.states[job]
        if status.state == "done":
            return 0.0
        return 1.0 - status.step / status.steps if status.steps else 1.0

    @property
    def hours_left(self) -> float:
        """Core-hours still to be paid."""
        return self.cost.core_hours({job: self.left(job) for job in self.states})


def forecast(plan: Plan, layout: Layout) -> Forecast:
    """What the plan will cost, given what the store already has and how fast it came about.

    Raises:
        UserError: a sweep record is damaged.
    """
    from rrmctl.planning.cost import estimate_cost
    from rrmctl.store.speeds import stored_speeds
    from rrmctl.store.status import statuses

    states = statuses(layout, plan.everything)
    return Forecast(plan, states, estimate_cost(plan, stored_speeds(layout, states)))


def in_words(forecast: Forecast, cores: int) -> str:
    """One line: core-hours left, hours on this machine, and where the numbers come from."""
    if forecast.count("done") == len(forecast.states):
        return "Everything is done; running it again does nothing."
    hours = forecast.hours_left
    # No number of cores makes a sweep shorter than its longest job.
    longest = max(forecast.cost.seconds[job] * forecast.left(job) for job in forecast.states) / 3600
    wall = max(hours / cores, longest)
    return (
        f"About {duration(hours)} of one core are left, {duration(wall)} on {cores} "
        f"core{'s' if cores > 1 else ''} ({forecast.cost.source})."
    )


def smaller(request: Request, plan: Plan) -> list[str]:
    """How to pay less: what the same request would cost in cheaper profiles, and how to ask for a part of it."""
    from rrmctl.planning.cost import estimate_cost, measure_gemm
    from rrmctl.planning.profiles import profiles

    gemm = measure_gemm()
    bound = estimate_cost(plan, {}, gemm).core_hours()
    seeds = {job.seed for job in plan.jobs}  # they cost the same, so one of them is planned
    lines = []
    for name, scale in profiles().items():
        if name == plan.profile:
            continue
        try:
            other = replace(request, profile=name, seeds=f"{min(seeds)},").plan()
        except UserError:  # a profile that cannot hold the request is no advice
            continue
        hours = estimate_cost(other, {}, gemm).core_hours(
            {job.id: len(seeds) for job in other.jobs}
        )  # shared needs once
        if hours < bound / 2:  # a profile that saves little is no advice
            lines.append(f"--profile {name}: about {duration(hours)} of one core; {scale.about}")
            bound = hours
    if len(plan.jobs) > 1:
        lines.append(
            "a part of it: fewer --seeds, some --tasks or --methods; the rest can be added later, nothing runs twice"
        )
    return lines


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
