"""What the paper's prose says of its experiments on states, as tests that a store can answer.

A claim is a conjunction of comparisons, each on every one of its tasks unless they are pooled. "Reaches 100 %", "near
60 %" and the like are taken within five points (`NEAR`); "at least 85 %" and "below 60 %" as they stand. A method that
"outperforms", "improves" or "converges faster" has the higher mean over the evaluations of its curve, unless the prose
speaks of a table or of the box figure; those are read where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.reports.series import Floats, Series, Steps

NEAR = 0.05


class Budget(NamedTuple):
    """A schedule of feedback, by its proportion to the experiment's fullest one: the same in every profile."""

    batch: float = 1.0  #: questions of a session
    every: float = 1.0  #: steps between sessions

    def __str__(self) -> str:
        if self == Budget():
            return "full feedback"
        return f"batch x {self.batch:g}" if self.every == 1 else f"every x {self.every:g}"


class Arm(NamedTuple):
    """Which series of a task is meant."""

    method: str
    teacher: str | None = None  #: None: the task's only one
    budget: Budget | None = None  #: None: the task's only one

    def __str__(self) -> str:
        told = [str(word) for word in (self.teacher, self.budget) if word is not None]
        return self.method + (f" ({', '.join(told)})" if told else "")


#: What a test looks at: steps [T] and values [S, T] of a series.
Measure = Callable[[Series], tuple[Steps, Floats]]


def scored(series: Series) -> tuple[Steps, Floats]:
    """The score the paper reports: success, or true return."""
    return series.steps, series.values


def label_accuracy(series: Series) -> tuple[Steps, Floats]:
    """Agreement of the learned reward with the teacher's labels."""
    return series.measure("label_accuracy")


def residual_beyond_prior(series: Series) -> tuple[Steps, Floats]:
    """By how much the residual's mean is further from zero than the prior's."""
    steps, residual = series.measure("residual_mean")
    return steps, np.abs(residual) - np.abs(series.measure("prior_mean")[1])


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What is read of a series' curve."""

    words: str
    steps: Literal["last", "common", "all"] = "last"  #: the last one up to `until`, the box figure's, all up to `until`
    until: float = 1.0  #: share of the training
    measure: Measure = scored
    unit: ScoreKind | None = None  #: how numbers are written; None: as the task's score
    spread: bool = False  #: the standard deviation of the seeds, not their interquartile mean


FINAL = Reading(words="last step")
BOX = Reading(words="common step", steps="common")
MEAN = Reading(words="mean over steps", steps="all")
SPREAD = Reading(words="standard deviation of the seeds, last step", spread=True)


@dataclass(frozen=True, kw_only=True)
class Test:
    """One comparison: of an arm with a bound, or with another arm."""

    __test__ = False  # pytest takes everything called so for its own

    arm: Arm
    relation: Literal["at least", "below", "above"]  #: "above" is of two arms: the difference is above zero
    than: float | Arm
    reading: Reading

    def __str__(self) -> str:
        if isinstance(self.than, Arm):
            return f"{self.arm} {self.relation} {self.than}"
        bound = f"{self.than:g}" if self.reading.unit == "return" else f"{100 * self.than:g} %"
        return f"{self.arm} {self.relation} {bound}"


def at_least(bound: float, *methods: str | Arm, reading: Reading = FINAL) -> tuple[Test, ...]:
    """Each of the methods reaches the bound."""
    return tuple(Test(arm=_arm(each), relation="at least", than=bound, reading=reading) for each in methods)


def below(bound: float, *methods: str | Arm, reading: Reading = FINAL) -> tuple[Test, ...]:
    """Each of the methods stays below the bound."""
    return tuple(Test(arm=_arm(each), relation="below", than=bound, reading=reading) for each in methods)


def above(other: str | Arm, *methods: str | Arm, reading: Reading = MEAN) -> tuple[Test, ...]:
    """Each of the methods is above the other."""
    return tuple(Test(arm=_arm(each), relation="above", than=_arm(other), reading=reading) for each in methods)


def _arm(method: str | Arm) -> Arm:
    return method if isinstance(method, Arm) else Arm(method)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A sentence of the paper and the comparisons that it stands for; it holds where all of them do."""

    name: str
    says: str  #: the paper's words, shortened
    where: str  #: section or figure
    experiment: str
    tasks: tuple[str, ...]
    tests: tuple[Test, ...]
    pooled: bool = False  #: all tasks in one number; otherwise each by itself
