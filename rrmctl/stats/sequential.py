"""When are there enough seeds? A group-sequential permutation test of several comparisons, after AdaStop.

After every group of n seeds of each method one looks at the comparisons that are still open, at most K times. The
statistic of a comparison is the sum over the groups of the difference of the two methods' means. Splitting each group's
scores anew between the two methods tells how large it would be if they were alike. The boundary at look k is the
smallest that at most a share a k / K of these sequences of splits crosses at this look or before, in either direction.
Of m comparisons the first is decided at a = alpha / m, then one at alpha / (m - 1), and so on (Holm's step-down). At a
level that another left, a comparison may have crossed its boundary at an earlier look; it then decides as it did there.

Groups, statistic, splits and the even spending of the level are those of Mathieu, Della Vecchia, Shilova, Centa de
Medeiros, Kohler, Maillard and Preux, "AdaStop: adaptive statistical testing for sound comparisons of Deep RL agents",
TMLR 2024; why the step-down is Holm's, and what is controlled and what is not, is in docs/statistics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats, checked
from rrmctl.stats.bootstrap import interval_possible

#: `larger`, `smaller`: the first method is, as against the second. `equal`: not separated by the last look. `open`:
#: more seeds decide.
Decision = Literal["larger", "smaller", "equal", "open"]

#: That an outlook imagines.
FUTURES = 100
#: Sequences of splits: so many of them lie beyond the boundaries by the last look, but no more than these in all.
_CROSSING, _MOST = 20, 4000


@dataclass(frozen=True, kw_only=True)
class Design:
    """How often one looks and what errors one bears; fixed before the first look."""

    group: int = 5  #: seeds of each method between two looks
    looks: int = 4  #: at most; group * looks seeds are the most that may be run
    alpha: float = 0.05  #: probability of any wrong decision, over all comparisons and looks
    permutations: int = 10_000  #: sequences of splits, about
    seed: int = 0  #: of the splits that are drawn at random

    def __post_init__(self) -> None:
        if min(self.group, self.looks, self.permutations) < 1 or self.group > 8:
            raise ValueError(f"a design has groups of 1 to 8 seeds, at least one look and one permutation: {self}")
        if not 0.0 < self.alpha < 1.0:
            raise ValueError(f"a share of errors lies between 0 and 1: {self}")

    @property
    def seeds(self) -> int:
        """The most seeds of a method."""
        return self.group * self.looks


class Comparison(NamedTuple):
    """The scores of two methods, one a seed, in the order in which the seeds are used; [S] each."""

    ours: npt.ArrayLike
    theirs: npt.ArrayLike


@dataclass(frozen=True)
class Standing:
    """What is known of one comparison."""

    decision: Decision
    looks: int  #: after which it was decided; looks so far where it is open
    #: Of the means, ours minus theirs, over the seeds of these looks; NaN before the first. Its sign may be another
    #: than the decision's, where that is of an earlier look and the level for it was left later.
    difference: float

    @property
    def separated(self) -> bool:
        """Whether one method was found to be better."""
        return self.decision in ("larger", "smaller")


def sequential_test(comparisons: Sequence[Comparison], design: Design) -> list[Standing]:
    """Look after every full group of seeds.

    The same scores give the same verdicts, and as long as all open comparisons have the same groups, further ones
    change nothing that is decided. A comparison with fewer groups than another waits for its own; what is beyond the
    last full group is not looked at. Given are all comparisons that share the level, those without any seed yet too.
    """
    tested = [_Tested(comparison, design) for comparison in comparisons]
    verdicts: dict[int, Standing] = {}
    for looks in range(1, design.looks + 1):
        left = [at for at, one in enumerate(tested) if at not in verdicts and one.looks >= looks]
        for _ in comparisons:  # one that is decided leaves the others a larger share of the level
            level = design.alpha / max(1, len(tested) - sum(verdict.separated for verdict in verdicts.values()))
            for at in list(left):
                crossing = tested[at].crossing(level)
                if 0 < crossing <= looks:  # in favour of the one that was better where its boundary was crossed
                    decision: Decision = "larger" if tested[at].difference(crossing) > 0.0 else "smaller"
                    verdicts[at] = Standing(decision, looks, tested[at].difference(looks))
                    left.remove(at)
        if looks == design.looks:
            verdicts |= {at: Standing("equal", looks, tested[at].difference(looks)) for at in left}
    return [verdicts.get(at, Standing("open", one.looks, one.difference(one.looks))) for at, one in enumerate(tested)]


def boundaries(statistics: Sequence[Floats], looks: int, level: float) -> tuple[list[float], npt.NDArray[np.int64]]:
    """What a statistic must exceed at each look so far, and at which [B] each sequence of splits does, zero for never.

    Of the statistics of every sequence at these looks, [B] each, a share of `level` may exceed a boundary by the last
    of the `looks`; so much of it as has passed, by now.
    """
    bounds: list[float] = []
    first = np.zeros(len(statistics[0]), dtype=np.int64)
    for look, values in enumerate(statistics, start=1):
        staying = np.flatnonzero(first == 0)
        room = int(level * look / looks * len(values) + 1e-9) - (len(values) - len(staying))
        bounds.append(-np.inf if room >= len(staying) else float(-np.partition(-values[staying], room)[room]))
        first[staying[values[staying] > bounds[-1]]] = look
    return bounds, first


class _Tested:
    """One comparison and its statistic under every sequence of splits."""

    def __init__(self, comparison: Comparison, design: Design) -> None:
        self._design = design
        self._ours, self._theirs = map(_scores, comparison)
        self.looks = min(len(self._ours), len(self._theirs), design.seeds) // design.group
        self._crossings: dict[float, int] = {}
        signs = sequences(design.group, design.looks, design.permutations, design.seed)
        sums = np.zeros(len(signs[0]))
        self._statistics = []
        for look in range(self.looks):
            here = slice(look * design.group, (look + 1) * design.group)
            sums = sums + signs[look] @ np.concatenate([self._ours[here], self._theirs[here]])
            # In units in which equal sums are equal numbers, however they were rounded on the way.
            unit = 1e-9 * max(np.abs(self._ours[: here.stop]).max(), np.abs(self._theirs[: here.stop]).max(), 1e-290)
            self._statistics.append(np.round(np.abs(sums) / unit))

    def crossing(self, level: float) -> int:
        """At which look what was seen, the first sequence, exceeds its boundary; zero for not yet."""
        if level not in self._crossings:
            first = boundaries(self._statistics, self._design.looks, level)[1]
            self._crossings[level] = int(first[0])
        return self._crossings[level]

    def difference(self, looks: int) -> float:
        """Of the means over these looks, ours minus theirs; NaN before the first."""
        seeds = looks * self._design.group
        return float(self._ours[:seeds].mean() - self._theirs[:seeds].mean()) if looks else np.nan


def _scores(given: npt.ArrayLike) -> Floats:
    scores = np.asarray(given, dtype=np.float64)
    if scores.ndim != 1:
        raise ValueError(f"a test takes one score for each seed, not an array of shape {scores.shape}")
    return checked(scores) if scores.size else scores


@lru_cache(maxsize=4)
def sequences(group: int, looks: int, most: int, seed: int) -> tuple[Floats, ...]:
    """Ways in which the scores of two methods that are alike could have been dealt to them, group after group.

    Every way to split the 2 n scores of a group into n and n was then as likely as the one that came about. A sequence
    has a split for each group, as the signs of the scores: for each group [B, 2 group], +1 / group or -1 / group. The
    first sequence is what was seen.

    The first groups run through all their splits together, as long as `most` sequences have room for them, each as
    often as any other; the later ones are drawn at random, but for the first sequence, which changes nothing. With few
    groups of few runs that is every sequence there is. Such a set, taken after a random one of its own members, is
    distributed as before; so what was seen is, where the methods are alike, a member like any other. A test that lets
    through a share of at most alpha of the sequences then errs with a probability of at most alpha, however many there
    are: fewer only make it coarser. There are never fewer than one group has splits.
    """
    chosen: npt.NDArray[np.intp] = np.array(list(combinations(range(2 * group), group)))
    splits = np.full((len(chosen), 2 * group), -1.0 / group)  # every split, the observed one first
    np.put_along_axis(splits, chosen, 1.0 / group, axis=1)
    listed = next((n for n in range(looks, 1, -1) if len(splits) ** n <= most), 1)
    repeats = 1 if listed == looks else max(1, most // len(splits) ** listed)
    total = repeats * len(splits) ** listed
    drawn = []
    for look in range(looks):
        if look < listed:
            which = np.arange(total) // len(splits) ** look % len(splits)
        else:
            which = np.random.default_rng([seed, look]).integers(len(splits), size=total)
            which[0] = 0
        drawn.append(splits[which])
        drawn[-1].flags.writeable = False  # shared by all who ask
    return tuple(drawn)


@dataclass(frozen=True)
class Outlook:
    """What the futures of an open comparison hold."""

    share: float  #: of the futures that separate it by the last look; NaN with too few runs to imagine any
    more: int | None  #: seeds of each method after which half of the futures have separated it; None: later, or never


def outlook(
    comparison: Comparison, verdict: Standing, design: Design, *, rng: np.random.Generator, futures: int = FUTURES
) -> Outlook:
    """How many more seeds would likely separate an open comparison, judged by its scores so far.

    Each imagined future draws the runs so far of both methods with replacement and takes the result for what the
    methods do, so that the little that is known of them counts; draws the seeds to come from there; and goes on with
    the sequential test. It cannot know what no run has shown yet: with few seeds a rare failure is missing from it
    altogether, and a difference that is there by luck is believed. It is a help for planning, no result, and errs to
    the hopeful side. The design has as its `alpha` what is left of the level for this comparison.
    """
    if verdict.decision != "open":
        raise ValueError("only an open comparison has an outlook")
    ours, theirs = (np.asarray(scores, dtype=np.float64) for scores in comparison)
    if not interval_possible([len(ours), len(theirs)]):
        return Outlook(np.nan, None)
    quick = replace(design, permutations=min(design.permutations, _MOST, round(_CROSSING / design.alpha)))
    ends = []
    for _ in range(futures):
        imagined = Comparison(_future(ours, design.seeds, rng), _future(theirs, design.seeds, rng))
        (end,) = sequential_test([imagined], quick)
        # The quick test may see at an old look what the full one did not: the next look is the first that can count.
        ends.append(max(end.looks, verdict.looks + 1) * design.group if end.separated else np.inf)
    median = float(np.quantile(ends, 0.5, method="higher"))
    so_far = min(len(ours), len(theirs))
    more = max(0, int(median) - so_far) if np.isfinite(median) else None
    return Outlook(share=float(np.isfinite(ends).mean()), more=more)


def _future(scores: Floats, seeds: int, rng: np.random.Generator) -> Floats:
    """The runs so far and those to come, as many as there may be at most."""
    truth = rng.choice(scores, len(scores))
    return np.concatenate([scores, rng.choice(truth, max(0, seeds - len(scores)))])
