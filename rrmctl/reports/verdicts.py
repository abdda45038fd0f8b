"""Whether a claim holds in a store: held, not held, or not enough data.

A comparison is settled only where its whole interval lies on one side. A claim is held where all of its comparisons
are, and not held where one of them is refuted. Of k comparisons one is easily refuted by chance, so for that the
interval is taken at 1 - 0.05/k; being held asks for all at once and needs no such care.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from rrm.envs.tasks import ScoreKind as Unit
from rrmctl.errors import UserError
from rrmctl.planning.profiles import PAPER
from rrmctl.planning.schedules import Schedule
from rrmctl.reports.claims import Arm, Budget, Claim, Reading, Test
from rrmctl.reports.scores import Score, score
from rrmctl.reports.series import Floats, Section, Series, Steps
from rrmctl.reports.statistics import LEVEL, Statistics
from rrmctl.stats import MIN_RUNS, Estimate

Verdict = Literal["held", "not held", "not enough data"]

#: Profiles whose numbers are no results.
_UNJUDGED = ("smoke",)


@dataclass(frozen=True)
class Finding:
    """One comparison of a claim."""

    test: Test
    task: str  #: or several, pooled
    unit: Unit
    found: Estimate | None  #: of the arm, or of the difference; None where there is no data
    verdict: Verdict
    margin: float  #: by how much the interval is on the claim's side, below zero where it is not; NaN without data
    why: str  #: where there is not enough data, what is missing


@dataclass(frozen=True)
class Judgement:
    """A claim and what the store says of it."""

    claim: Claim
    verdict: Verdict
    findings: tuple[Finding, ...]

    @property
    def deciding(self) -> Finding:
        """The comparison on which the verdict rests: what is missing, else the one that is worst for the claim."""
        alike = [each for each in self.findings if each.verdict == self.verdict]
        return min(alike, key=lambda each: -math.inf if math.isnan(each.margin) else each.margin)


class MissingDataError(Exception):
    """A comparison cannot be made; the message says what is missing."""


def judge(claim: Claim, sections: Mapping[str, Section], settings: Statistics) -> Judgement:
    """The verdict on a claim from the sections of one variant, by experiment."""
    groups = [claim.tasks] if claim.pooled else [(task,) for task in claim.tasks]
    pairs = [(test, tasks) for tasks in groups for test in claim.tests]
    find = partial(_finding, section=sections.get(claim.experiment), claim=claim, rivals=len(pairs), settings=settings)
    findings = tuple(find(test, tasks) for test, tasks in pairs)
    verdicts = {each.verdict for each in findings}
    if "not held" in verdicts:
        return Judgement(claim, "not held", findings)
    return Judgement(claim, "held" if verdicts == {"held"} else "not enough data", findings)


def _finding(
    test: Test, tasks: Sequence[str], *, section: Section | None, claim: Claim, rivals: int, settings: Statistics
) -> Finding:
    names = ", ".join(tasks)
    try:
        if section is None:
            raise MissingDataError(f"no runs of {claim.experiment}")
        found, unit = _measured(test, tasks, section, settings)
    except (MissingDataError, UserError) as error:  # the latter: methods have no step in common
        return Finding(test, names, "success", None, "not enough data", math.nan, str(error))
    held, refuted = found.estimate(LEVEL), found.estimate(1 - (1 - LEVEL) / rivals)
    if section.profile in _UNJUDGED:
        return Finding(test, names, unit, held, "not enough data", math.nan, f"profile {section.profile} is no result")
    if found.draws is None:
        return Finding(
            test, names, unit, held, "not enough data", math.nan, f"{found.n} seeds; an interval needs {MIN_RUNS}"
        )
    sides = _settled(test, held), _settled(test, refuted)
    verdict: Verdict = "held" if sides[0] is True else "not held" if sides[1] is False else "not enough data"
    why = "" if verdict != "not enough data" else "the interval allows both"
    return Finding(test, names, unit, held, verdict, _margin(test, held), why)


def _settled(test: Test, found: Estimate) -> bool | None:
    """True where the whole interval is on the test's side, False where all of it is on the other, else None."""
    low, high = float(found.low), float(found.high)
    bound = _bound(test)
    if test.relation == "at least":
        return True if low >= bound else False if high < bound else None
    if test.relation == "below":
        return True if high < bound else False if low >= bound else None
    return True if low > bound else False if high <= bound else None


def _margin(test: Test, found: Estimate) -> float:
    bound = _bound(test)
    return bound - float(found.high) if test.relation == "below" else float(found.low) - bound


def _bound(test: Test) -> float:
    return test.than if isinstance(test.than, float) else 0.0


def _measured(test: Test, tasks: Sequence[str], section: Section, settings: Statistics) -> tuple[Score, Unit]:
    """The number that a test compares with its bound."""
    arms = [test.arm, *([test.than] if isinstance(test.than, Arm) else [])]
    read: list[list[Floats]] = [[] for _ in arms]
    for task in tasks:
        series = [_series(section, task, arm) for arm in arms]
        for values, each in zip(read, _values(section, series, test.reading), strict=True):
            values.append(each)
    statistic = _deviation if test.reading.spread else None
    pooled = test.reading.steps != "all"
    scores = [
        score(each, settings, pooled=pooled, stream=stream, statistic=statistic)
        for stream, each in enumerate(read, start=1)
    ]
    found = scores[0] - scores[1] if len(scores) > 1 else scores[0]
    return found, test.reading.unit or series[0].score


def _deviation(scores: Floats) -> Floats:
    """Of the population that the seeds are drawn from, so that methods with few seeds do not seem steadier."""
    if scores.shape[-1] == 1:
        return np.full(scores.shape[:-1], np.nan)
    return np.asarray(np.std(scores, axis=-1, ddof=1))


def _series(section: Section, task: str, arm: Arm) -> Series:
    """The one finished series that an arm means.

    Raises:
        MissingDataError: there is none, or it is not finished.
    """
    named = [each for each in section.series if (each.label.task, each.label.method) == (task, arm.method)]
    found = [each for each in named if arm.teacher in (None, each.label.teacher)]
    if arm.budget is not None:
        asked = [(each, Schedule.of(each.label.feedback)) for each in found]
        found = [each for each, schedule in asked if schedule and _is(arm.budget, schedule, _fullest(section, task))]
    if not any(each.n for each in found):
        raise MissingDataError(f"no runs of {arm}, {task}")
    if len(found) > 1:
        raise MissingDataError(f"{arm} stands for {len(found)} series of {task}")
    if not found[0].finished:
        raise MissingDataError(f"{arm}, {task}: runs are under way")
    return found[0]


def _fullest(section: Section, task: str) -> tuple[int, int]:
    """Questions of the largest session and steps of the shortest interval among a task's schedules."""
    labels = [each.label for each in section.series if each.label.task == task]
    known = [schedule for label in labels if (schedule := Schedule.of(label.feedback))]
    return max(each.batch for each in known), min(each.every for each in known)


def _is(budget: Budget, asked: Schedule, full: tuple[int, int]) -> bool:
    return math.isclose(asked.batch / full[0], budget.batch, rel_tol=0.1) and math.isclose(
        asked.every / full[1], budget.every, rel_tol=0.1
    )


def _values(section: Section, series: Sequence[Series], reading: Reading) -> Iterator[Floats]:
    """What is read of each series [S, T], at the same steps of all.

    Raises:
        MissingDataError: no step is common to them, or a value is not a number.
    """
    measured = [reading.measure(each) for each in series]
    steps = measured[0][0]
    for other, _ in measured[1:]:
        steps = np.intersect1d(steps, other)
    steps = _chosen(section, series, steps, reading)
    for (own, values), each in zip(measured, series, strict=True):
        at = values[:, np.searchsorted(own, steps)]
        if not np.isfinite(at).all():
            raise MissingDataError(f"{each.label}: {reading.words} is not measured")
        yield at


def _chosen(section: Section, series: Sequence[Series], steps: Steps, reading: Reading) -> Steps:
    """Those of the common steps that the reading asks for."""
    if reading.steps == "common":
        panels = [panel for panel in section.panels() if any(each in panel.series for each in series)]
        steps = steps[steps == panels[0].read_at().step]
    elif steps.size:
        steps = steps[steps <= reading.until * steps[-1]]
        steps = steps[-1:] if reading.steps == "last" else steps
    if not steps.size:
        raise MissingDataError(f"{series[0].label}: no evaluation at {reading.words}")
    return steps


def at_profile(verdict: Verdict, section: Section) -> str:
    """The verdict, with the scale where it is not the paper's and whatever else was set otherwise."""
    told = [] if section.profile == PAPER else [f"profile {section.profile}"]
    told += [f"{key}={value}" for key, value in section.overrides.items()]
    return verdict + (f" ({', '.join(told)})" if told else "")
