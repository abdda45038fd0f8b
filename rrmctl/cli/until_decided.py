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
    from rrmctl.reports.pairwise import Contest, Contests
    from rrmctl.store.layout import Layout
    from rrmctl.store.sweeps import SweepRecord
    from rrmctl.store.trials import Pairing, Trial

#: Runs the jobs of a plan that are not done, and says how that ended.
Execute = Callable[["Plan"], tuple[Exit, "SweepRecord"]]


@dataclass(frozen=True)
class Rules:
    """What the options ask for."""

    most: int  #: seeds of a method
    group: int  #: seeds between two looks
    against: str | None  #: the method that the others are compared with; None: the first


def asked_rules(until: bool, most: int | None, group: int | None, against: str | None, *, other: bool) -> Rules | None:
    """The rules that the options ask for; None without --until-decided.

    Args:
        until: --until-decided was given.
        most, group, against: --max-seeds, --group and --against.
        other: an option was given that says otherwise which runs to make.

    Raises:
        UserError: options that do not go together.
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
        fitting = [str(each) for each in (most // size * size, (most // size + 1) * size) if each]
        raise UserError(
            f"--max-seeds {most} is no whole number of groups of {size} seeds",
            f"--max-seeds {' or '.join(fitting)}, or another --group",
        )
    return Rules(most, size, against)


def until_decided(layout: Layout, plan: Plan, rules: Rules, execute: Execute) -> tuple[Exit, SweepRecord]:
    """Run groups of seeds until every comparison is decided or the most seeds are run, and say what was decided.

    Args:
        plan: of all seeds that may be run.
        rules: of the test.
        execute: runs a part of the plan.

    Returns:
        How the last part ended, and the record of what was run.

    Raises:
        UserError: nothing to compare, or a test with other rules was begun on these runs.
    """
    from rrmctl.store.status import statuses
    from rrmctl.store.trials import begin_trial

    trial = _trial(plan, rules)
    begin_trial(layout, plan.experiment, plan.variant, trial)
    seeds = sorted({job.seed for job in plan.jobs})
    left, sweep = list(trial.pairs), None
    for look in range(1, trial.looks + 1):
        here = seeds[: look * trial.group]
        code, part = execute(_part(plan, here, left))
        sweep = part if sweep is None else sweep.union(part)
        done = all(status.state == "done" for status in statuses(layout, part.everything).values())
        if code is not Exit.DONE or not done:  # runs that failed before are not tried again unasked
            tell("Nothing more is decided before these runs are done; the same command goes on.")
            break
        found = _look(layout, plan, trial, here)
        _tell(found, look, len(here))
        left = [each.pair for each in found.open]
        if not left:
            break
    assert sweep is not None  # there is at least one look
    return code, sweep


def _trial(plan: Plan, rules: Rules) -> Trial:
    from rrmctl.reports.pairwise import against
    from rrmctl.stats import Design
    from rrmctl.store.trials import Trial

    pairs = tuple(against((job.row for job in plan.jobs), rules.against))
    return Trial(group=rules.group, looks=rules.most // rules.group, alpha=Design().alpha, pairs=pairs)


def _part(plan: Plan, seeds: Iterable[int], pairs: Iterable[Pairing]) -> Plan:
    """The jobs of these seeds that the pairs need, and what those need."""
    from rrmctl.store.sweeps import required

    wanted = {Label(pair.task, method, *asked) for pair in pairs for method in (pair.method, pair.against)
              for asked in ((pair.teacher, pair.feedback), ())}  # fmt: skip
    chosen = set(seeds)
    jobs = [job for job in plan.jobs if job.seed in chosen and job.row in wanted]
    needed = required(jobs, plan.everything)
    return replace(plan, jobs=tuple(jobs), needed=tuple(job for job in plan.needed if job.id in needed))


def _look(layout: Layout, plan: Plan, trial: Trial, seeds: list[int]) -> Contests:
    """Where the comparisons stand with these seeds.

    Raises:
        UserError: a run is done and has no score, or the runs do not belong together.
    """
    from rrmctl.reports.pairwise import decide
    from rrmctl.reports.select import read_sections

    sections = read_sections(layout.root, plan.experiment)
    (section,) = (each for each in sections if each.variant == plan.variant)
    found = decide(section.accepted(), trial, seeds=seeds)
    for each in found.open:
        if each.verdict.looks * trial.group < len(seeds):
            raise UserError(
                f"{_name(each.pair)}: a run is done, but cannot be scored",
                f"`{rrmctl('report', 'power', plan.experiment, results=layout.root)}` says which and why",
            )
    return found


def _tell(found: Contests, look: int, seeds: int) -> None:
    """What is decided so far, a line a comparison."""
    tell(f"Look {look} of {found.design.looks}, after {seeds} seeds:")
    for each in found.contests:
        tell(f"  {_name(each.pair)}: {_said(each, found.design.group)}")


def _name(pair: Pairing) -> str:
    where = Label(pair.task, pair.method, pair.teacher, pair.feedback).place
    return f"{where}, {pair.method} against {pair.against}"


def _said(contest: Contest, group: int) -> str:
    from rrmctl.reports.report import number

    verdict = contest.verdict
    apart = f"mean score over training differs by {number(verdict.difference, contest.score)}"
    match verdict.decision:
        case "larger" | "smaller":
            word = "better" if verdict.decision == "larger" else "worse"
            return f"{word}, decided by the first {verdict.looks * group} seeds; {apart}"
        case "equal":
            return f"not separated by {verdict.looks * group} seeds; {apart}"
        case _:
            return f"open; {apart}"
