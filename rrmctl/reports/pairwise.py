"""Which methods are compared with which, by which number a seed, and what the sequential test says of them so far.

A run's number is its mean score over training, the area under its own curve: it is known as soon as the run is done and
depends on no other run, as the step at which `report iqm` reads all methods does. So all of its own evaluations count,
and a run that was not a number at one of them has none.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, takewhile

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.errors import UserError
from rrmctl.labels import NOTHING_ASKED, Label, panels
from rrmctl.reports.series import SCORE_COLUMN, Section, Series
from rrmctl.stats import Comparison, Design, Floats, Standing, area_under_curve, sequential_test
from rrmctl.store.trials import Pairing, Trial


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
    all: tuple[Contest, ...]

    @property
    def remaining(self) -> Design:
        """The design of a comparison that is not separated, with the share of the level that is left for it."""
        left = sum(not contest.verdict.separated for contest in self.all)
        return replace(self.design, alpha=self.design.alpha / max(1, left))

    @property
    def open(self) -> list[Contest]:
        """Those that more seeds decide."""
        return [contest for contest in self.all if contest.verdict.decision == "open"]


def every_pair(labels: Iterable[Label]) -> list[Pairing]:
    """Each method of each panel against those before it; two that ask nothing once for their task."""
    pairs = (_pair(later, earlier) for panel in panels(labels).values() for earlier, later in combinations(panel, 2))
    return list(dict.fromkeys(pairs))


def against(labels: Iterable[Label], method: str | None) -> list[Pairing]:
    """Each method of each panel against one (None: the first); refused where a panel lacks it, or has no other."""
    pairs = []
    for panel in panels(labels).values():
        methods = {label.method: label for label in panel}
        one = method or panel[0].method
        if one not in methods or len(methods) < 2:
            what = f"there is no {one}" if one not in methods else f"{one} is the only method"
            raise UserError(f"{panel[0].task}: {what}, so nothing is compared", f"it has: {', '.join(methods)}")
        pairs += [_pair(other, methods[one]) for other in panel if other.method != one]
    return list(dict.fromkeys(pairs))


def decide(section: Section, trial: Trial | None, *, seeds: Collection[int] | None = None) -> Contests:
    """The comparisons of a section and where they stand.

    Args:
        section: its finished runs count.
        trial: the rules of the test; None compares every pair, in groups of five seeds and at most as many looks as are
            planned, but no fewer than four.
        seeds: look at these alone; None looks at all.
    """
    if trial is None:
        pairs, usual = every_pair(series.label for series in section.series), Design()
        most = max((series.planned for series in section.series), default=0)
        design = Design(looks=max(usual.looks, -(-most // usual.group)))
    else:
        pairs, design = list(trial.pairs), Design(group=trial.group, looks=trial.looks, alpha=trial.alpha)
    by_label = {series.label: _scores(series, seeds) for series in section.series}
    kinds = {series.label.task: series.score for series in section.series}
    sides = []
    for pair in pairs:
        asking = [Label(pair.task, method, pair.teacher, pair.feedback) for method in (pair.method, pair.against)]
        labels = [label if label in by_label else Label(label.task, label.method) for label in asking]
        scores = [by_label.get(label, {}) for label in labels]
        if not all(scores):  # nothing is said of one alone
            scores = [{}, {}]
        planned = {absent.seed for absent in section.absent if absent.label in labels}
        planned |= {seed for series in section.series if series.label in labels for seed in series.seeds}
        order = sorted(planned if seeds is None else planned.intersection(seeds))
        tested = Comparison(*([own[seed] for seed in takewhile(own.__contains__, order)] for own in scores))
        ours, theirs = (np.array(list(own.values())) for own in scores)
        sides.append((pair, kinds.get(pair.task, "success"), ours, theirs, tested))
    verdicts = sequential_test([tested for *_, tested in sides], design)
    return Contests(design, tuple(Contest(*side, verdict) for side, verdict in zip(sides, verdicts, strict=True)))


def without_score(section: Section) -> Iterator[str]:
    """The finished runs that cannot be compared by this number, and why not."""
    for series in (series for series in section.series if series.finished):
        column = SCORE_COLUMN[series.score]
        for (seed, run), lacking in series.rows[~np.isfinite(series.rows[column])].groupby(["seed", "run"]):
            yield (
                f"{series.label}: run {run} (seed {seed}) is not compared: {column} is not a number at "
                f"{len(lacking)} of its evaluations (first at step {lacking['step'].min():,})"
            )


def _pair(method: Label, other: Label) -> Pairing:
    """Of two labels of a panel; its teacher and feedback are those of the one that asks."""
    asking = other if method.teacher == NOTHING_ASKED else method
    return Pairing(asking.task, asking.teacher, asking.feedback, method.method, other.method)


def _scores(series: Series, seeds: Collection[int] | None) -> dict[int, float]:
    """The number of each finished run by its seed, of its own evaluations alone; none where one is not a number."""
    if not series.finished:
        return {}
    scores = {}
    for seed in sorted(set(series.rows["seed"].tolist()) if seeds is None else seeds):
        own = series.rows[series.rows["seed"] == seed].sort_values("step")
        values = own[SCORE_COLUMN[series.score]].to_numpy(dtype=np.float64)
        if values.size and np.isfinite(values).all():
            scores[seed] = float(area_under_curve(own["step"], values))
    return scores
