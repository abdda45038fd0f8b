"""How many more seeds would likely decide a comparison, judged by the runs so far.

Each imagined future draws the runs so far of both methods with replacement and takes the result for what the methods
do, so that the little that is known of them counts; draws the seeds to come from there; and goes on with the sequential
test. It cannot know what no run has shown yet: with few seeds a rare failure is missing from it altogether, and a
difference that is there by luck is believed. It is a help for planning, no result, and errs to the hopeful side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rrmctl.stats.aggregate import Floats
from rrmctl.stats.bootstrap import interval_possible
from rrmctl.stats.sequential import Comparison, Design, Standing, sequential_test

FUTURES = 100
#: Sequences of splits: so many of them lie beyond the boundaries by the last look, but no more than these in all.
_CROSSING, _MOST = 20, 4000


@dataclass(frozen=True)
class Outlook:
    """What the futures of an open comparison hold."""

    share: float  #: of the futures that separate it by the last look; NaN with too few runs to imagine any
    more: int | None  #: seeds of each method after which half of the futures have separated it; None: later, or never


def outlook(
    comparison: Comparison,
    verdict: Standing,
    design: Design,
    *,
    rng: np.random.Generator,
    futures: int = FUTURES,
) -> Outlook:
    """How many more seeds would likely separate an open comparison.

    Args:
        comparison: the scores so far.
        verdict: what the test found in them.
        design: of the test, with what is left of the level for this comparison as its `alpha`.
        rng: the only source of randomness.
        futures: how many are imagined.

    Raises:
        ValueError: the comparison is not open.
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
        (found,) = sequential_test([imagined], quick)
        # The quick test may see at an old look what the full one did not: the next look is the first that can count.
        ends.append(max(found.looks, verdict.looks + 1) * design.group if found.separated else np.inf)
    median = float(np.quantile(ends, 0.5, method="higher"))
    so_far = min(len(ours), len(theirs))
    more = max(0, int(median) - so_far) if np.isfinite(median) else None
    return Outlook(share=float(np.isfinite(ends).mean()), more=more)


def _future(known: Floats, seeds: int, rng: np.random.Generator) -> Floats:
    """The runs so far and those to come, as many as there may be at most."""
    truth = rng.choice(known, len(known))
    return np.concatenate([known, rng.choice(truth, max(0, seeds - len(known)))])
