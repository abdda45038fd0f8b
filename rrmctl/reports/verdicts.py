"""Whether a claim holds in a store: held, not held, or not enough data.

A comparison is settled only where its whole interval lies on one side. A claim is held where all of its comparisons
are, and not held where one of them is refuted. Of k comparisons one is easily refuted by chance, so for that the
interval is taken at 1 - 0.05/k; being held asks for all at once and needs no such care.

An interval of few seeds cannot be as sure as its level says: of three runs its ends are the lowest and the highest,
whatever the level. So nothing is settled where chance alone brings all runs to one side more often than 5 % (5 %/k).

What was planned is judged when all of it has been run: not the seeds that came through, nor those that came first.
Tasks of a claim that nobody planned are left out, and the verdict says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from rrm.envs.tasks import ScoreKind as Unit
from rrmctl.errors import UserError
from rrmctl.labels import Schedule
from rrmctl.reports.claims import Arm, Claim, Reading, Test
from rrmctl.reports.scores import score
from rrmctl.reports.series import Panel, Section, Series, at_steps, ending
from rrmctl.reports.statistics import BOOTSTRAP_SEED, LEVEL, Statistics
from rrmctl.stats import MIN_RUNS, Estimate, Floats, Iqm, read_at_common_step

Verdict = Literal["held", "not held", "not enough data"]


@dataclass(frozen=True)
class Finding:
    """One comparison of a claim."""

    test: Test
    task: str  #: or several, pooled
    unit: Unit = "success"
    estimate: Estimate | None = None  #: of the arm, or of the difference; None where there is no data
    verdict: Verdict = "not enough data"
    margin: float = -math.inf  #: by how much the interval is on the claim's side, below zero where it is not
    why: str = ""  #: where there is not enough data, what is missing


@dataclass(frozen=True)
class Judgement:
    """What the store says of a claim."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    tasks: tuple[str, ...]  #: those of the claim on which it was judged

    @property
    def deciding(self) -> Finding:
        """The comparison on which the verdict rests: what is missing, else the one that is worst for the claim."""
        alike = [finding for finding in self.findings if finding.verdict == self.verdict]
        return min(alike, key=lambda finding: finding.margin)


def judge(claim: Claim, sections: Mapping[str, Section], settings: Statistics) -> Judgement:
    """The verdict on a claim from the sections of one variant, by experiment."""
    section = sections.get(claim.experiment)
    judged = tuple(task for task in claim.tasks if section is not None and _is_planned(section, task, claim.tests))
    tasks = judged or claim.tasks
    groups = [tasks] if claim.pooled else [(task,) for task in tasks]
    rivals = len(groups) * len(claim.tests)
    findings = []
    for group in groups:
        for test in claim.tests:
            try:
                if section is None:
                    raise UserError(f"no runs of {claim.experiment}")
                findings.append(_finding(test, group, section.accepted(), rivals, settings))
            except UserError as error:
                findings.append(Finding(test, ", ".join(group), why=str(error)))
    verdicts = {finding.verdict for finding in findings}
    verdict: Verdict = "not held" if "not held" in verdicts else "held" if verdicts == {"held"} else "not enough data"
    return Judgement(verdict, tuple(findings), tasks)


def _is_planned(section: Section, task: str, tests: Iterable[Test]) -> bool:
    """Whether the section plans, on this task, everything that these tests compare."""
    planned = {series.label.method for series in section.series if series.label.task == task}
    return planned.issuperset(arm.method for test in tests for arm in (test.arm, test.than) if isinstance(arm, Arm))


def _finding(test: Test, tasks: Sequence[str], section: Section, rivals: int, settings: Statistics) -> Finding:
    """What the section says of one of so many rival comparisons; the error says why it says nothing."""
    arms = [arm for arm in (test.arm, test.than) if isinstance(arm, Arm)]
    series = [[_series(section, task, arm) for arm in arms] for task in tasks]
    read = [list(_values(section, own, test.reading, settings.last)) for own in series]
    statistic, pooled = _deviation if test.reading.spread else None, test.reading.pooled
    scores = [
        score(values, settings, pooled=pooled, stream=stream, statistic=statistic)
        for stream, values in enumerate(zip(*read, strict=True), start=1)
    ]
    if test.reading.steps == "common" and not any(np.isnan(score.draws).all() for score in scores):
        draws = _draws_at_common_step(section, series, settings)
        scores = [replace(score, draws=own) for score, own in zip(scores, draws, strict=True)]
    measured = scores[0] - scores[1] if len(scores) > 1 else scores[0]
    estimate = measured.estimate()
    what = (test, ", ".join(tasks), test.reading.unit or series[0][0].score, estimate)
    if section.profile == "smoke":
        return Finding(*what, why=f"profile {section.profile} is no result")
    if np.isnan(measured.draws).all():
        return Finding(*what, why=f"{estimate.n} seeds; an interval needs {MIN_RUNS}")
    (worst, _), (_, best) = _beyond(test, estimate), _beyond(test, measured.estimate(1 - (1 - LEVEL) / rivals))
    on_bound = test.relation == "at least"  # a value on the bound is on the claim's side
    chance = by_chance([[one.n for one in own] for own in series])
    verdict: Verdict
    if worst > 0 or (on_bound and worst == 0):
        verdict, most = "held", 1 - LEVEL
    elif best < 0 or (not on_bound and best == 0):
        verdict, most = "not held", (1 - LEVEL) / rivals
    else:
        return Finding(*what, "not enough data", worst, "the interval allows both")
    if chance > most * (1 + 1e-9):
        odds = f"chance alone brings so few to one side in {100 * chance:.3g} % of studies; at most {100 * most:.3g} %"
        return Finding(*what, "not enough data", worst, f"{estimate.n} seeds: {odds} are allowed")
    return Finding(*what, verdict, worst)


def by_chance(runs: Sequence[Sequence[int]]) -> float:
    """How probable it is that all runs lie on one given side where nothing puts them there. Of several tasks in one
    number it is that of the one with the fewest: in the others all seeds may be alike, and say nothing.

    Args:
        runs: for each task the runs of the one method that is held against a bound, each as likely above as below; or
            of the two that are compared, where every order of them is as likely: those of one are all above the
            other's.
    """
    return max(0.5 ** own[0] if len(own) == 1 else 1 / math.comb(sum(own), own[0]) for own in runs)


def _beyond(test: Test, estimate: Estimate) -> tuple[float, float]:
    """By how much the interval's ends are on the claim's side, the worse one first."""
    bound, low, high = 0.0 if isinstance(test.than, Arm) else test.than, float(estimate.low), float(estimate.high)
    return (bound - high, bound - low) if test.relation == "below" else (low - bound, high - bound)


def _deviation(scores: Floats) -> Floats:
    """Of the population that the seeds are drawn from, so that methods with few seeds do not seem steadier."""
    if scores.shape[-1] == 1:
        return np.full(scores.shape[:-1], np.nan)
    return np.asarray(np.std(scores, axis=-1, ddof=1))


def _series(section: Section, task: str, arm: Arm) -> Series:
    """The one series that an arm means, all of its runs finished; the error says why there is none."""
    of_task = [(series, Schedule.of(series.label.feedback)) for series in section.series if series.label.task == task]
    numbers = [*zip(*(schedule[:3] for _, schedule in of_task if schedule), strict=True)] or [(1,)] * 3
    fullest = [pick(those) for pick, those in zip((max, min, max), numbers, strict=True)]

    def is_meant(series: Series, schedule: Schedule | None) -> bool:
        if series.label.method != arm.method or arm.teacher not in (None, series.label.teacher):
            return False
        if arm.budget is None or schedule is None:
            return arm.budget is None
        shares = zip(schedule[:3], fullest, arm.budget, strict=True)
        return all(
            wanted is None or math.isclose(number / most, wanted, rel_tol=0.1) for number, most, wanted in shares
        )

    meant = [series for series, schedule in of_task if is_meant(series, schedule)]
    if not any(series.n for series in meant):
        raise UserError(f"no runs of {arm.words}, {task}")
    if len(meant) > 1:
        raise UserError(f"{arm.words} stands for {len(meant)} series of {task}")
    if problem := _incomplete(meant[0]):
        raise UserError(f"{arm.words}, {task}: {problem}")
    return meant[0]


def _incomplete(series: Series) -> str:
    """What is missing where not all planned runs of a series are finished; else nothing."""
    done = series.n if series.finished else 0
    return f"{done} of {series.planned} planned runs are finished" if done < series.planned else ""


def _values(section: Section, series: Sequence[Series], reading: Reading, last: int) -> Iterator[Floats]:
    """What is read of each series [S, T], at the same steps of all; the error says why there is nothing.

    A score at one step is the mean of the `last` evaluations up to it.
    """
    measured = [reading.of(one) for one in series]
    steps = reduce(np.intersect1d, (own for own, _ in measured))
    if reading.steps == "common":
        steps = steps[steps == _panel(section, series[0]).read_at().step]
    elif steps.size:
        steps = steps[steps <= reading.until * steps[-1]]
        steps = steps[-1:] if reading.steps == "last" else steps
    if not steps.size:
        raise UserError(f"{series[0].label}: no evaluation at {reading.words}")
    for (own, values), one in zip(measured, series, strict=True):
        single = reading.steps == "all" or reading.measure is not None
        at = ending(values, np.searchsorted(own, steps), 1 if single else last)
        if not np.isfinite(at).all():
            raise UserError(f"{one.label}: {reading.words} is not measured")
        yield at


def _panel(section: Section, series: Series) -> Panel:
    """The comparison that a series stands in; the error says what of it is missing: the step is of all its methods."""
    panels = [panel for panel in section.panels() if series in panel.series]
    if len(panels) != 1:
        raise UserError(f"{series.label} stands in {len(panels)} comparisons, of which each has a step of its own")
    panel = panels[0]
    if missing := [f"{one.label.method} {problem}" for one in panel.series if (problem := _incomplete(one))]:
        raise UserError(f"{panel.task}: the step is common to all methods; of {'; of '.join(missing)}")
    return panel


def _draws_at_common_step(section: Section, series: Sequence[Sequence[Series]], settings: Statistics) -> list[Floats]:
    """Of series that are compared, for each task, the replicates [R] of their interquartile means over all tasks' seeds
    at the step of the box figure, which is chosen anew in each.
    """
    drawn = []
    for at, own in enumerate(series):
        panel = _panel(section, own[0])
        steps, rng = panel.steps(), np.random.default_rng([BOOTSTRAP_SEED, at])
        values = {one.label.method: at_steps(one, steps, settings.last) for one in own}
        read = read_at_common_step(panel.rivals(), values, rng=rng, replicates=settings.replicates)
        drawn.append([read[one.label.method] for one in own])
    return [Iqm(settings.kind)(np.concatenate(own, axis=-1)) for own in zip(*drawn, strict=True)]
