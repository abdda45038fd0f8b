"""What `plan` and `run` say of a plan beforehand: what it costs, what would cost less, and what to know of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from rrmctl.cli.progress import runs
from rrmctl.cli.request import duration
from rrmctl.errors import UserError
from rrmctl.hardware import usable_cores

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.cli.request import Forecast, Request
    from rrmctl.planning.plan import Plan

#: Work above which a person at a terminal is asked first, core-hours.
LARGE_H = 1.0


def introduce(console: Console, request: Request, expected: Forecast, slots: int) -> None:
    """Say what a command is about to run, what it costs, and what would cost less."""
    plan = expected.plan
    counts = {"done already": expected.count("done"), "failed": expected.count("failed")}
    there = "".join(f", {count} {state}" for state, count in counts.items() if count)
    more = f" and {len(plan.needed)} that they need" if plan.needed else ""
    said = f"{plan.experiment} ({plan.variant}): {runs(len(plan.jobs))}{more}{there}."
    console.print(said, style="bold", soft_wrap=True)
    console.print(in_words(expected, slots), soft_wrap=True)
    advise(console, request, expected, LARGE_H)


def in_words(expected: Forecast, cores: int) -> str:
    """One line: core-hours left, hours on this machine, and where the numbers come from."""
    if expected.count("done") == len(expected.states):
        return "Everything is done; running it again does nothing."
    hours, shares = expected.hours_left, expected.shares
    # No number of cores makes a sweep shorter than its longest job.
    longest = max(expected.cost.seconds[job] * share for job, share in shares.items()) / 3600
    return (
        f"About {duration(hours)} of one core are left, {duration(max(hours / cores, longest))} on {cores} "
        f"core{'s' if cores > 1 else ''} ({expected.cost.source})."
    )


def advise(console: Console, request: Request, expected: Forecast, least_hours: float) -> None:
    """Note what the plan will hardly be meant to do; where more core-hours are left, say how to pay less."""
    notes = list(_unasked(expected.plan))
    threads, cores = max(job.config.threads for job in expected.plan.jobs), usable_cores()
    if threads > cores:
        notes.append(f"threads: {threads} for each run, on {cores} core{'s' if cores > 1 else ''}")
    for note in notes:
        console.print(f"  note: {note}", soft_wrap=True)
    if expected.hours_left > least_hours:
        for line in smaller(request, expected.plan):
            console.print(f"  smaller: {line}", soft_wrap=True)


def smaller(request: Request, plan: Plan) -> list[str]:
    """How to pay less: what the same request would cost in cheaper profiles, and how to ask for a part of it."""
    from rrmctl.planning.cost import estimate_cost
    from rrmctl.planning.profiles import profiles

    bound = estimate_cost(plan, {}).core_hours()
    seeds = {job.seed for job in plan.jobs}  # they cost the same, so one of them is planned
    lines = []
    for name, scale in profiles().items():
        if name == plan.profile:
            continue
        try:
            other = replace(request, profile=name, seeds=f"{min(seeds)},").plan()
        except UserError:  # a profile that cannot hold the request is no advice
            continue
        # What all seeds need is run once.
        hours = estimate_cost(other, {}).core_hours({job.id: len(seeds) for job in other.jobs})
        if hours < bound / 2:  # a profile that saves little is no advice
            lines.append(f"--profile {name}: about {duration(hours)} of one core; {scale.about}")
            bound = hours
    if len(plan.jobs) > 1:
        lines.append(
            "a part of it: fewer --seeds, some --tasks or --methods; the rest can be added later, nothing runs twice"
        )
    return lines


def _unasked(plan: Plan) -> Iterator[str]:
    """Budgets of feedback that a run is too short to spend, those that fall short alike in one line."""
    short: defaultdict[str, dict[str, None]] = defaultdict(dict)
    for job in {job.row: job for job in plan.jobs}.values():  # every seed asks the same
        config = job.config
        if config.kind == "train" and config.feedback and (queries := config.queries()) < config.feedback.budget:
            fit = f"{queries:,} of {config.feedback.budget:,} questions fit into {config.steps:,} steps"
            short[fit][f"{job.task} {job.method}"] = None
    return (f"{fit}: {', '.join(names)}" for fit, names in short.items())
