"""Whether a claim holds in a store: held, not held, or not enough data.

A comparison is settled only where its whole interval lies on one side. A claim is held where all of its comparisons
are, and not held where one of them is refuted. Of k comparisons one is easily refuted by chance, so for that the
interval is taken at 1 - 0.05/k; being held asks for all at once and needs no such care.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np

from rrm.envs.tasks import ScoreKind as Unit
from rrmctl.errors import UserError
from rrmctl.labels import Schedule
from rrmctl.reports.claims import Arm, Claim, Reading, Test
from rrmctl.reports.scores import score
from rrmctl.reports.series import Section, Series, ending
from rrmctl.reports.statistics import LEVEL, Statistics
from rrmctl.stats import MIN_RUNS, Estimate, Floats

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

    @property
    def deciding(self) -> Finding:
        """The comparison on which the verdict rests: what is missing, else the one that is worst for the claim."""
        alike = [finding for finding in self.findings if finding.verdict == self.verdict]
        return min(alike, key=lambda finding: finding.margin)


def judge(claim: Claim, sections: Mapping[str, Section], settings: Statistics) -> Judgement:
    """The verdict on a claim from the sections of one variant, by experiment."""
    groups = [claim.tasks] if claim.pooled else [(task,) for task in claim.tasks]
    rivals = len(groups) * len(claim.tests)
    findings = []
    for tasks in groups:
        for test in claim.tests:
            try:
                if claim.experiment not in sections:
                    raise UserError(f"no runs of {claim.experiment}")
                findings.append(_finding(test, tasks, sections[claim.experiment], rivals, settings))
            except UserError as error:
                findings.append(Finding(test, ", ".join(tasks), why=str(error)))
    verdicts = {finding.verdict for finding in findings}
    verdict: Verdict = "not held" if "not held" in verdicts else "held" if verdicts == {"held"} else "not enough data"
    return Judgement(verdict, tuple(findings))


def _finding(test: Test, tasks: Sequence[str], section: Section, rivals: int, settings: Statistics) -> Finding:
    """What the section says of one of so many rival comparisons; the error says why it says nothing."""
    arms, read = [arm for arm in (test.arm, test.than) if isinstance(arm, Arm)], []
    for task in tasks:
        series = [_series(section, task, arm) for arm in arms]
        read.append(list(_values(section, series, test.reading, settings.last)))
    statistic, pooled = _deviation if test.reading.spread else None, test.reading.pooled
    scores = [
        score(values, settings, pooled=pooled, stream=stream, statistic=statistic)
        for stream, values in enumerate(zip(*read, strict=True), start=1)
    ]
    measured = scores[0] - scores[1] if len(scores) > 1 else scores[0]
    estimate = measured.estimate()
    what = (test, ", ".join(tasks), test.reading.unit or series[0].score, estimate)
    if section.profile == "smoke":
        return Finding(*what, why=f"profile {section.profile} is no result")
    if np.isnan(measured.draws).all():
        return Finding(*what, why=f"{estimate.n} seeds; an interval needs {MIN_RUNS}")
    (worst, _), (_, best) = _beyond(test, estimate), _beyond(test, measured.estimate(1 - (1 - LEVEL) / rivals))
    on_bound = test.relation == "at least"  # a value on the bound is on the claim's side
    if worst > 0 or (on_bound and worst == 0):
        return Finding(*what, "held", worst)
    if best < 0 or (not on_bound and best == 0):
        return Finding(*what, "not held", worst)
    return Finding(*what, "not enough data", worst, "the interval allows both")


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
    """The one finished series that an arm means; the error says why there is none."""
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
    if not meant[0].finished:
        raise UserError(f"{arm.words}, {task}: runs are under way")
    return meant[0]


def _values(section: Section, series: Sequence[Series], reading: Reading, last: int) -> Iterator[Floats]:
    """What is read of each series [S, T], at the same steps of all; the error says why there is nothing.

    A score at one step is the mean of the `last` evaluations up to it.
    """
    measured = [reading.of(one) for one in series]
    steps = reduce(np.intersect1d, (own for own, _ in measured))
    if reading.steps == "common":
        panels = [panel for panel in section.panels() if any(one in panel.series for one in series)]
        steps = steps[steps == panels[0].read_at().step]
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
