"""What the options of `plan` and `run` ask for, what it will cost, and what a person is told of both beforehand."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.hardware import usable_cores
from rrmctl.cli.options import split_names
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.planning.plan import Plan
    from rrmctl.store.layout import Layout
    from rrmctl.store.status import Status

#: Work above which a person at a terminal is asked first, core-hours.
LARGE_H = 1.0


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
    device: str | None = None

    @property
    def assignments(self) -> list[str]:
        """The overrides, that of the device among them."""
        said = [text for text in self.overrides or [] if text.partition("=")[0].strip() == "device"]
        if said and self.device is not None:
            raise UserError(f"--device {self.device} and --set {said[0]} set one setting", "give one of them")
        if self.device is not None and not re.fullmatch(r"cpu|auto|cuda(:\d+)?", self.device):
            raise UserError(
                f"--device is {self.device}", "it is cpu, cuda, the number of a card such as cuda:1, or auto"
            )
        return [*(self.overrides or []), *([] if self.device is None else [f"device={self.device}"])]

    @property
    def card(self) -> str | None:
        """The number of the card that is asked for, as `--gpus` takes it; None where any will do."""
        from rrmctl.planning.settings import parse_assignments

        named = [text for text in self.assignments if text.partition("=")[0].strip() == "device"]
        return str(parse_assignments(named).get("device", "")).partition(":")[2] or None

    def plan(self) -> Plan:
        """The jobs; a `UserError` where the experiment is unknown, or an option does not fit it."""
        from rrmctl.planning.experiments import find
        from rrmctl.planning.manifest import load
        from rrmctl.planning.plan import make_plan

        return make_plan(
            load(find(self.name, self.experiments)), profile=self.profile, seeds=self.seeds,
            tasks=split_names(self.tasks), methods=split_names(self.methods),
            overrides=self.assignments, priors=self.priors or [],
        )  # fmt: skip


@dataclass(frozen=True)
class Forecast:
    """A plan, where each of its runs stands, and what is left to pay."""

    plan: Plan
    states: Mapping[str, Status]  #: by job id
    seconds: Mapping[str, float | None]  #: from nothing to the end, by job id; None where nobody knows
    measured: int  #: jobs whose cost comes from stored runs

    def count(self, state: str) -> int:
        """Jobs in this state."""
        return sum(status.state == state for status in self.states.values())

    @property
    def seconds_left(self) -> dict[str, float]:
        """Of one core, still to be paid, by job id; of those whose cost is known."""
        shares = {
            job: 0.0 if status.state == "done" else 1.0 - status.step / status.steps if status.steps else 1.0
            for job, status in self.states.items()
        }
        return {job: whole * shares[job] for job, whole in self.seconds.items() if whole is not None}

    @property
    def unknown(self) -> int:
        """Jobs that are not done and whose cost nobody knows."""
        return sum(self.seconds[job] is None and status.state != "done" for job, status in self.states.items())

    @property
    def hours(self) -> float:
        """Core-hours from nothing to the end, of what is known."""
        return sum(whole for whole in self.seconds.values() if whole is not None) / 3600

    @property
    def hours_left(self) -> float:
        """Core-hours still to be paid, of what is known."""
        return sum(self.seconds_left.values()) / 3600

    @property
    def on_cards(self) -> int:
        """Jobs that are on graphics cards."""
        from rrmctl.planning.cost import on_card

        return sum(map(on_card, self.plan.configs.values()))


def forecast(plan: Plan, layout: Layout) -> Forecast:
    """What the plan will cost, given what the store already has and how fast it came about."""
    from rrmctl.planning.cost import estimate_seconds
    from rrmctl.store.status import statuses, stored_speeds

    states = statuses(layout, plan.everything)
    speeds = stored_speeds(layout, states)
    measured = sum((job.task, job.method, plan.variant) in speeds for job in plan.everything)
    return Forecast(plan, states, estimate_seconds(plan, speeds), measured)


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


def introduce(console: Console, request: Request, expected: Forecast, slots: int) -> None:
    """Say what a command is about to run, what it costs, and what would cost less."""
    plan, count = expected.plan, len(expected.plan.jobs)
    counts = {"done already": expected.count("done"), "failed": expected.count("failed")}
    states = "".join(f", {number} {state}" for state, number in counts.items() if number)
    heading = f"{plan.experiment} ({plan.variant}): {count} run{'s' if count != 1 else ''}{beside(plan)}{states}."
    console.print(heading, style="bold", soft_wrap=True)
    console.print(in_words(expected, slots), soft_wrap=True)
    advise(console, request, expected, LARGE_H)


def beside(plan: Plan) -> str:
    """What is run beside the jobs: ` and 3 that they need`, ` and 4 deployments of theirs`."""
    counts = ((len(plan.needed), "that they need"), (len(plan.deployments), "that deploy them"))
    return "".join(f" and {count} {words}" for count, words in counts if count)


#: What is said of runs on cards where nobody has measured one.
_UNMEASURED = "nobody has measured a card of this machine: `rrmctl doctor --tune` does, where the card is"


def in_words(expected: Forecast, slots: int) -> str:
    """One line: core-hours left, hours on this machine with so many runs at a time, and where the numbers come from."""
    if expected.count("done") == len(expected.states):
        return "Everything is done; running it again does nothing."
    hours, jobs, source = expected.hours_left, len(expected.states), "from the speed of stored runs"
    if expected.unknown and not hours:
        return f"How long it takes is not known: {_UNMEASURED}."
    if expected.measured < jobs:
        cards = " or of a card" if expected.on_cards else ""
        table = f"an estimate from the measured speed of one core{cards} and a table of costs"
        source = f"{expected.measured} of {jobs} jobs {source}, the rest {table}" if expected.measured else table
    # No number of cores makes a sweep shorter than its longest job.
    longest = max(expected.seconds_left.values()) / 3600
    places = f"{slots} core{'s' if slots > 1 else ''}"
    if expected.on_cards == jobs:
        places = f"the cards, {slots} run{'s' if slots > 1 else ''} at a time"
    rest = f" How long {expected.unknown} jobs on cards take is not known: {_UNMEASURED}." if expected.unknown else ""
    return (
        f"About {duration(hours)} of one core are left, {duration(max(hours / slots, longest))} on {places} "
        f"({source}).{rest}"
    )


def advise(console: Console, request: Request, expected: Forecast, least_hours: float) -> None:
    """Note what the plan will hardly be meant to do; where more core-hours are left, say how to pay less."""
    # Budgets that a run is too short to spend, those that fall short alike in one line.
    short: defaultdict[str, dict[str, None]] = defaultdict(dict)
    for job in {job.row: job for job in expected.plan.jobs}.values():  # every seed asks the same
        config = expected.plan.configs[job.id]
        if config.kind == "train" and config.feedback and (queries := config.queries()) < config.feedback.budget:
            fit = f"{queries:,} of {config.feedback.budget:,} questions fit into {config.steps:,} steps"
            short[fit][f"{job.task} {job.method}"] = None
    for fit, methods in short.items():
        console.print(f"  note: {fit}: {', '.join(methods)}", soft_wrap=True)
    threads, cores = max(expected.plan.configs[job.id].threads for job in expected.plan.jobs), usable_cores()
    if threads > cores:
        note = f"threads: {threads} for each run, on {cores} core{'s' if cores > 1 else ''}"
        console.print(f"  note: {note}", soft_wrap=True)
    if expected.hours_left > least_hours:
        for line in smaller(request, expected.plan):
            console.print(f"  smaller: {line}", soft_wrap=True)


def smaller(request: Request, plan: Plan) -> list[str]:
    """How to pay less: what the same request would cost in cheaper profiles, and how to ask for a part of it."""
    from rrmctl.planning.cost import estimate_seconds
    from rrmctl.planning.profiles import profiles

    whole = estimate_seconds(plan, {})
    bound = sum(each or 0.0 for each in whole.values())
    seeds = {job.seed for job in plan.jobs}  # they cost the same, so one of them is planned
    lines = []
    for name, scale in profiles().items():
        if name == plan.profile or None in whole.values():
            continue
        try:
            other = replace(request, profile=name, seeds=f"{min(seeds)},").plan()
        except UserError:  # a profile that cannot hold the request is no advice
            continue
        costs = estimate_seconds(other, {})
        once = {job: each or 0.0 for job, each in costs.items()}  # what all seeds need is run once
        seconds = sum(once.values()) + (len(seeds) - 1) * sum(once[job.id] for job in other.jobs)
        if seconds < bound / 2:  # a profile that saves little is no advice
            lines.append(f"--profile {name}: about {duration(seconds / 3600)} of one core; {scale.about}")
            bound = seconds
    if len(plan.jobs) > 1:
        lines.append(
            "a part of it: fewer --seeds, some --tasks or --methods; the rest can be added later, nothing runs twice"
        )
    return lines
