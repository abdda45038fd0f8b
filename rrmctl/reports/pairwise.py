"""Which methods are compared with which, by which number a seed, and what the sequential test says of them so far.

A run's number is its mean score over training, the area under its own curve: it is known as soon as the run is done and
depends on no other run, as the step at which `report iqm` reads all methods does. So all of its own evaluations count,
and a run that was not a number at one of them has none.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import combinations, takewhile

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.errors import UserError
from rrmctl.labels import NOTHING_ASKED, Label, panels
from rrmctl.reports.series import SCORE_COLUMN, Floats, Section, Series
from rrmctl.stats import Comparison, Design, Standing, area_under_curve, sequential_test
from rrmctl.store.trials import Pairing, Trial

#: The number of each run, by seed.
Scores = dict[int, float]


@dataclass(frozen=True, eq=False)
class Contest:
    """Two methods and the scores of their finished runs."""

    pair: Pairing
    score: ScoreKind
    ours: Floats  #: [S], of all seeds that are done
    theirs: Floats
    tested: Comparison  #: the same in the order of the planned seeds, up to the first that is missing
    verdict: Standing


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
    """Each method of each panel against those before it; two that ask nothing once for their task."""
    pairs = (_pair(later, earlier) for panel in panels(labels).values() for earlier, later in combinations(panel, 2))
    return list(dict.fromkeys(pairs))


def against(labels: Iterable[Label], method: str | None) -> list[Pairing]:
    """Each method of each panel against one; None takes the first.

    Raises:
        UserError: a panel lacks the method, or has no other.
    """
    found = []
    for panel in panels(labels).values():
        known = {each.method: each for each in panel}
        one = method or panel[0].method
        if one not in known or len(known) < 2:
            what = f"there is no {one}" if one not in known else f"{one} is the only method"
            raise UserError(f"{panel[0].task}: {what}, so nothing is compared", f"it has: {', '.join(known)}")
        found += [_pair(other, known[one]) for other in panel if other.method != one]
    return list(dict.fromkeys(found))


def decide(section: Section, trial: Trial | None, *, seeds: Collection[int] | None = None) -> Contests:
    """The comparisons of a section and where they stand.

    Args:
        section: its finished runs count.
        trial: the rules of the test; None compares every pair, in groups of five seeds and at most as many looks as are
            planned, but no fewer than four.
        seeds: look at these alone; None looks at all.
    """
    pairs = every_pair(series.label for series in section.series) if trial is None else trial.pairs
    if trial is None:
        usual = Design()
        planned = max((each.planned for each in section.series), default=0)
        design = Design(looks=max(usual.looks, -(-planned // usual.group)))
    else:
        design = Design(group=trial.group, looks=trial.looks, alpha=trial.alpha)
    known = {series.label: _scores(series, seeds) for series in section.series}
    labels = [(_labelled(known, pair, pair.method), _labelled(known, pair, pair.against)) for pair in pairs]
    scores = [(known.get(one, {}), known.get(other, {})) for one, other in labels]
    scores = [each if all(each) else ({}, {}) for each in scores]  # nothing is said of one alone
    tested = [_in_order(section, two, *each, seeds=seeds) for two, each in zip(labels, scores, strict=True)]
    kinds = {series.label.task: series.score for series in section.series}
    contests = [
        Contest(pair, kinds.get(pair.task, "success"), _array(ours), _array(theirs), comparison, verdict)
        for pair, (ours, theirs), comparison, verdict in zip(
            pairs, scores, tested, sequential_test(tested, design), strict=True
        )
    ]
    return Contests(design, tuple(contests))


def without_score(series: Series) -> list[str]:
    """The finished runs of a series that cannot be compared by this number, and why not."""
    rows = series.rows[~np.isfinite(series.rows[SCORE_COLUMN[series.score]])] if series.finished else series.rows[:0]
    return [
        f"{series.label}: run {run} (seed {seed}) is not compared: {SCORE_COLUMN[series.score]} is not a number at "
        f"{len(own)} of its evaluations (first at step {own['step'].min():,})"
        for (seed, run), own in rows.groupby(["seed", "run"])
    ]


def _pair(method: Label, other: Label) -> Pairing:
    """Of two labels of a panel; its teacher and feedback are those of the one that asks."""
    asked = other if method.teacher == NOTHING_ASKED else method
    return Pairing(asked.task, asked.teacher, asked.feedback, method.method, other.method)


def _scores(series: Series, seeds: Collection[int] | None) -> Scores:
    """The number of each finished run, of its own evaluations alone; none where one of them is not a number."""
    if not series.finished:
        return {}
    found = {}
    for seed in sorted(set(series.rows["seed"].tolist()) if seeds is None else seeds):
        own = series.rows[series.rows["seed"] == seed].sort_values("step")
        values = own[SCORE_COLUMN[series.score]].to_numpy(dtype=np.float64)
        if values.size and np.isfinite(values).all():
            found[seed] = float(area_under_curve(own["step"], values))
    return found


def _labelled(known: Collection[Label], pair: Pairing, method: str) -> Label:
    """What a method of a pair is called in its section, whether it asks or not."""
    asking = Label(pair.task, method, pair.teacher, pair.feedback)
    return asking if asking in known else Label(pair.task, method)


def _in_order(
    section: Section, labels: Collection[Label], ours: Scores, theirs: Scores, *, seeds: Collection[int] | None
) -> Comparison:
    """The scores in the order of the seeds that were planned for either method, up to the first missing one of each."""
    planned = {each.seed for each in section.absent if each.label in labels}
    planned |= {seed for each in section.series if each.label in labels for seed in each.seeds}
    order = sorted(planned if seeds is None else planned.intersection(seeds))
    return Comparison(*([each[seed] for seed in takewhile(each.__contains__, order)] for each in (ours, theirs)))


def _array(scores: Scores) -> Floats:
    return np.array(list(scores.values()))
