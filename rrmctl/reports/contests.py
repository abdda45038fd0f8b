"""Which methods are compared with which, by which number a seed, and what the sequential test says of them so far.

A run's number is its mean score over training, the area under its own curve: it is known as soon as the run is done and
depends on no other run, as the step at which `report iqm` reads all methods does.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import combinations, takewhile

import numpy as np

from rrm.envs.tasks import Score
from rrmctl.errors import UserError
from rrmctl.reports.series import NOTHING_ASKED, Floats, Label, Section, Series, at_steps
from rrmctl.stats import Comparison, Design, Verdict, area_under_curve, sequential_test
from rrmctl.store.trials import Pairing, Trial

#: The number of each run, by seed.
Scores = dict[int, float]


@dataclass(frozen=True, eq=False)
class Contest:
    """Two methods and the scores of their finished runs."""

    pair: Pairing
    score: Score
    ours: Floats  #: [S], of all seeds that are done
    theirs: Floats
    tested: Comparison  #: the same in the order of the planned seeds, up to the first that is missing
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class Contests:
    """All comparisons that share one level."""

    design: Design
    contests: tuple[Contest, ...]

    @property
    def remaining(self) -> Design:
        """The design of a comparison that is not separated, with the share of the level that is left for it."""
        left = sum(not each.verdict.separated for each in self.contests)
        return replace(self.design, alpha=self.design.alpha / max(1, left))

    @property
    def open(self) -> list[Contest]:
        """Those that more seeds decide."""
        return [each for each in self.contests if each.verdict.decision == "open"]


def every_pair(labels: Iterable[Label]) -> list[Pairing]:
    """Each method of each panel against those before it."""
    return [
        Pairing(*where, later, earlier)
        for where, methods in _panels(labels).items()
        for earlier, later in combinations(methods, 2)
    ]


def against(labels: Iterable[Label], method: str | None) -> list[Pairing]:
    """Each method of each panel against one; None takes the first.

    Raises:
        UserError: a panel lacks the method, or has no other.
    """
    found = []
    for where, methods in _panels(labels).items():
        one = method or methods[0]
        if one not in methods or len(methods) < 2:
            what = f"there is no {one}" if one not in methods else f"{one} is the only method"
            raise UserError(f"{where[0]}: {what}, so nothing is compared", f"it has: {', '.join(methods)}")
        found += [Pairing(*where, other, one) for other in methods if other != one]
    return found


def decide(section: Section, trial: Trial | None, *, seeds: Collection[int] | None = None) -> Contests:
    """The comparisons of a section and where they stand.

    Args:
        section: its finished runs count.
        trial: the rules of the test; None compares every pair, in groups of five seeds and at most as many looks as are
            planned, but no fewer than four.
        seeds: look at these alone; None looks at all.
    """
    labels = [series.label for series in section.series]
    pairs = every_pair(labels) if trial is None else trial.pairs
    if trial is None:
        usual = Design()
        planned = max((each.planned for each in section.series), default=0)
        design = Design(looks=max(usual.looks, -(-planned // usual.group)))
    else:
        design = Design(group=trial.group, looks=trial.looks, alpha=trial.alpha)
    scores = [_scores(section, pair, seeds) for pair in pairs]
    tested = [_in_order(section, pair, *each) for pair, each in zip(pairs, scores, strict=True)]
    kinds = {series.label.task: series.score for series in section.series}
    contests = [
        Contest(pair, kinds.get(pair.task, "success"), _array(ours), _array(theirs), comparison, verdict)
        for pair, (ours, theirs), comparison, verdict in zip(
            pairs, scores, tested, sequential_test(tested, design), strict=True
        )
    ]
    return Contests(design, tuple(contests))


def _panels(labels: Iterable[Label]) -> dict[tuple[str, str, str], list[str]]:
    """Methods by task, teacher and feedback; what asks nothing is in every panel of its task."""
    distinct = list(dict.fromkeys(labels))
    found = {}
    for task in dict.fromkeys(label.task for label in distinct):
        here = [label for label in distinct if label.task == task]
        asked = dict.fromkeys((each.teacher, each.feedback) for each in here if each.teacher != NOTHING_ASKED)
        for where in asked or {(NOTHING_ASKED, NOTHING_ASKED): None}:
            own = (where, (NOTHING_ASKED, NOTHING_ASKED))
            found[task, *where] = [each.method for each in here if (each.teacher, each.feedback) in own]
    return found


def _scores(section: Section, pair: Pairing, seeds: Collection[int] | None) -> tuple[Scores, Scores]:
    """The number of each seed of both methods; steps that only one of them has do not count."""
    both = [_series(section, pair, method) for method in (pair.method, pair.against)]
    done = [each for each in both if each is not None and each.n and each.finished]
    if len(done) < 2:
        return {}, {}
    steps = np.intersect1d(done[0].steps, done[1].steps)
    if steps.size == 0:
        raise UserError(f"{pair.task}: {pair.method} and {pair.against} have no evaluation step in common")
    areas = [area_under_curve(steps, at_steps(each, steps)) for each in done]
    ours, theirs = (
        {seed: float(area) for seed, area in zip(each.seeds, found, strict=True) if seeds is None or seed in seeds}
        for each, found in zip(done, areas, strict=True)
    )
    return ours, theirs


def _series(section: Section, pair: Pairing, method: str) -> Series | None:
    labels = (Label(pair.task, method, *asked) for asked in (pair[1:3], (NOTHING_ASKED, NOTHING_ASKED)))
    known = {series.label: series for series in section.series}
    return next((known[label] for label in labels if label in known), None)


def _in_order(section: Section, pair: Pairing, ours: Scores, theirs: Scores) -> Comparison:
    """The scores in the order of the seeds that were planned for either method, up to the first missing one of each."""
    missing = {
        each.seed
        for each in section.absent
        if each.label.task == pair.task and each.label.method in (pair.method, pair.against)
    }
    order = sorted({*ours, *theirs} | missing)
    return Comparison(*([each[seed] for seed in takewhile(each.__contains__, order)] for each in (ours, theirs)))


def _array(scores: Scores) -> Floats:
    return np.array(list(scores.values()))
