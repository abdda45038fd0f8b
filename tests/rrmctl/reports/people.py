"""People with known failings, and what they answer: the truth that reports are held against."""

import hashlib
import itertools
from dataclasses import dataclass

import numpy as np

from rrm.teachers.labels import EQUAL, FIRST, SECOND, SKIPPED, Label, write_labels
from rrmctl.store.layout import Layout
from tests.rrmctl.reports.frames import RISING, Sweep

LENGTH = 100  #: answers of a sitting


@dataclass(frozen=True)
class Person:
    """Shares of all answers, each drawn by itself."""

    name: str
    error: float = 0.1  #: prefers the clip that is worth less
    tiring: float = 0.0  #: error that a hundred answers add
    left: float = 0.0  #: presses left without a look
    hint: float = 0.0  #: of those with returns shown, prefers what they praise without a look
    seconds: float = 2.0  #: the median at the start of a sitting
    slowing: float = 0.0  #: of the logarithm of the latency in a hundred answers
    blur: float = 0.0  #: difference of returns at which two thirds of what cannot be told at 0 can be told
    tie: float = 0.0
    skip: float = 0.0

    def right(self, shown=False, at=0):
        """How likely it is that a decided answer agrees with the true return, at some place of a sitting."""
        looks = 1 - self._errs(at)
        seen = self.hint * shown
        return self.left / 2 + (1 - self.left) * (seen + (1 - seen) * looks)

    def _errs(self, at, difference=np.inf):
        error = self.error + self.tiring * at / 100
        return error + (0.5 - error) * (np.exp(-difference / self.blur) if self.blur else 0)

    def answer(self, rng, first, second, shown_left, shown, at):
        """What is said of two returns, and after how long, ms."""
        latency = 1000 * self.seconds * np.exp(self.slowing * at / 100 + rng.normal(0, 0.4))
        better = FIRST if first > second else SECOND
        draw = rng.random(5)
        if draw[0] < self.skip:
            return SKIPPED, latency
        if draw[1] < self.tie:
            return EQUAL, latency
        if draw[2] < self.left:
            return shown_left, latency
        if shown and draw[3] < self.hint:
            return better, latency
        return (better if draw[4] >= self._errs(at, abs(first - second)) else FIRST + SECOND - better), latency


def answered(person, rng, pairs, *, run="", purpose="train", shown=lambda at: True, start=0, begin=1e9):
    """A label for each pair (step, index, query, first return, second return), asked one after the other."""
    labels = []
    for at, (step, index, query, first, second) in enumerate(pairs, start=start):
        side, hint, place = int(rng.integers(2)), shown(at), at % LENGTH
        answer, latency = person.answer(rng, first, second, side, hint, place)
        labels.append(Label(
            run=run, step=step, index=index, query=query, first="a" * 16, second="b" * 16, answer=answer,
            shown_left=side, return_first=first, return_second=second, return_shown=hint, annotator=person.name,
            purpose=purpose, latency_ms=latency, loops=1.5, speed=1.0, input="key", shown_at=begin + 10.0 * at,
            at=begin + 10.0 * at + latency / 1000, session=f"{person.name}-{at // LENGTH}", sealed=purpose == "train",
        ))  # fmt: skip
    return labels


def pairs(rng, count, *, step=10_000, name=""):
    """Pairs of clips with returns that differ more or less."""
    returns = rng.normal(100, 30, (count, 2))
    ids = (hashlib.sha256(repr((name, step, at, *returns[at])).encode()).hexdigest()[:16] for at in range(count))
    return [(step, at, query, *map(float, two)) for at, (query, two) in enumerate(zip(ids, returns, strict=True))]


def sweep(**settings):
    """Ten runs under people: two methods with five seeds each."""
    curves = {"pebble": RISING["pebble"], "rrm-h2o": RISING["rrm-proxy"]}
    told = {"curves": curves, "tasks": ("window-open",), "experiment": "human-study", "teacher": "human"}
    return Sweep(**told | settings)


def study(root, people, rng, *, queries=100, shared=20, repeat=0, hint=lambda at: True, **settings):
    """A store of ten runs whose queries people answered in turn, so that nobody labels one seed twice.

    Returns:
        The labels of each run, and those of none, as they were written.
    """
    made = sweep(**settings)
    made.write(root)
    layout, runs = Layout(root), list(dict.fromkeys(made.jobs()["run"]))
    given = {}
    common = pairs(rng, shared, step=0, name="shared")
    taken = dict.fromkeys(people, 0)
    extra = []
    for person in people:
        extra += answered(person, rng, common, purpose="shared", shown=hint)
        taken[person] += shared
    for run, person in zip(runs, itertools.cycle(people), strict=False):
        own = pairs(rng, queries, name=run)
        given[run] = answered(person, rng, own, run=run, shown=hint, start=taken[person])
        again = answered(
            person, rng, own[:repeat], run=run, purpose="repeat", shown=hint, start=taken[person] + queries
        )
        given[run] += again
        taken[person] += queries + repeat
        write_labels(layout.run(run).labels, given[run])
    layout.extra_labels.parent.mkdir(parents=True)
    write_labels(layout.extra_labels, extra)
    return given, extra


FIVE = (
    Person("anna", error=0.10),
    Person("ben", error=0.20, left=0.15),
    Person("cleo", error=0.05, tiring=0.20, slowing=0.5),
    Person("dilan", error=0.25, hint=0.6),
    Person("eva", error=0.15, tie=0.05, skip=0.05, seconds=4.0),
)
