"""`run --until-decided`: groups of seeds, and a look at the comparisons after each, until all are decided.

What is decided follows from the finished runs and the rules, which are written down before the first look
(`rrmctl.store.trials`); nothing else is remembered. Interrupted and called again, the command comes to the same looks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rrmctl.cli.screen import tell
from rrmctl.commands import rrmctl
from rrmctl.errors import Exit, UserError
from rrmctl.labels import Label

if TYPE_CHECKING:
    from rrmctl.planning.plan import Plan
    from rrmctl.store.layout import Layout
    from rrmctl.store.sweeps import SweepRecord
    from rrmctl.store.trials import Pairing

#: In words, after so many seeds.
_DECISIONS = {
    "larger": "better, decided by the first {} seeds",
    "smaller": "worse, decided by the first {} seeds",
    "equal": "not separated by {} seeds",
    "open": "open",
}


@dataclass(frozen=True)
class Rules:
    """What the options ask for."""

    most: int  #: seeds of a method
    group: int  #: seeds between two looks
    against: str | None  #: the method that the others are compared with; None: the first


def asked_rules(until: bool, most: int | None, group: int | None, against: str | None, *, other: bool) -> Rules | None:
    """The rules that the options ask for; None without --until-decided. Refuses options that do not go together.

    `most` is --max-seeds; `other` says whether an option was given that says otherwise which runs to make.
    """
    if not until:
        if (most, group, against) != (None, None, None):
            raise UserError("--max-seeds, --group and --against belong to --until-decided", "--seeds N runs N seeds")
        return None
    if most is None or other:
        raise UserError("--until-decided takes --max-seeds N, and neither --seeds nor --force")
    from rrmctl.stats import Design

    size = group or Design().group
    if most % size:
        fitting = [str(seeds) for seeds in (most // size * size, (most // size + 1) * size) if seeds]
        raise UserError(
            f"--max-seeds {most} is no whole number of groups of {size} seeds",
            f"--max-seeds {' or '.join(fitting)}, or another --group",
        )
    return Rules(most, size, against)


def until_decided(
    layout: Layout, plan: Plan, rules: Rules, execute: Callable[[Plan], tuple[Exit, SweepRecord]]
) -> tuple[Exit, SweepRecord]:
    """Run groups of seeds until every comparison is decided or the most seeds are run, and say what was decided.

    The plan is of all seeds that may be run; `execute` runs those jobs of a part of it that are not done, and says how
    that ended. Returned is how the last part ended, and the record of what was run. Refused: nothing to compare, or
    other rules than those of the test that was begun on these runs.
    """
    from rrmctl.reports.columns import number
    from rrmctl.reports.pairwise import against, decide
    from rrmctl.reports.select import read_sections
    from rrmctl.stats import Design
    from rrmctl.store.status import statuses
    from rrmctl.store.trials import Trial, begin_trial

    pairs = tuple(against((job.row for job in plan.jobs), rules.against))
    trial = Trial(group=rules.group, looks=rules.most // rules.group, alpha=Design().alpha, pairs=pairs)
    begin_trial(layout, plan.experiment, plan.variant, trial)
    seeds = sorted({job.seed for job in plan.jobs})
    left, sweep = list(pairs), None
    for look in range(1, trial.looks + 1):
        here = seeds[: look * trial.group]
        code, part = execute(_part(plan, here, left))
        sweep = part if sweep is None else sweep.union(part)
        done = all(status.state == "done" for status in statuses(layout, part.everything).values())
        if code is not Exit.DONE or not done:  # runs that failed before are not tried again unasked
            tell("Nothing more is decided before these runs are done; the same command goes on.")
            break
        sections = read_sections(layout.root, plan.experiment)
        (section,) = (section for section in sections if section.variant == plan.variant)
        contests = decide(section.accepted(), trial, seeds=here)
        for contest in contests.open:
            if contest.verdict.looks * trial.group < len(here):
                raise UserError(
                    f"{contest.pair}: a run is done, but cannot be scored",
                    f"`{rrmctl('report', 'power', plan.experiment, results=layout.root)}` says which and why",
                )
        tell(f"Look {look} of {trial.looks}, after {len(here)} seeds:")
        for contest in contests.all:
            decision = _DECISIONS[contest.verdict.decision].format(contest.verdict.looks * trial.group)
            apart = number(contest.verdict.difference, contest.score)
            tell(f"  {contest.pair}: {decision}; mean score over training differs by {apart}")
        left = [contest.pair for contest in contests.open]
        if not left:
            break
    assert sweep is not None  # there is at least one look
    return code, sweep


def _part(plan: Plan, seeds: Iterable[int], pairs: Iterable[Pairing]) -> Plan:
    """The jobs of these seeds that the pairs need, and what those need."""
    from rrmctl.store.sweeps import deployments_of, required

    wanted = {Label(pair.task, method, *teaching) for pair in pairs for method in (pair.method, pair.against)
              for teaching in ((pair.teacher, pair.feedback), ())}  # fmt: skip
    chosen = set(seeds)
    jobs = [job for job in plan.jobs if job.seed in chosen and job.row in wanted]
    needed = required(jobs, plan.everything)
    return replace(
        plan, jobs=tuple(jobs), needed=tuple(job for job in plan.needed if job.id in needed),
        deployments=deployments_of(jobs, plan.deployments),
    )  # fmt: skip
