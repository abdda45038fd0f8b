"""Two methods beside one another: the difference of a statistic, and how often one is better.

Seeds are no pairs by default (docs/statistics.md): both methods are resampled on their own. `paired=True` draws the
same seeds for both, for runs that do have more in common (one start network, one set of demonstrations); where they
have not, it gains nothing, and with few seeds it takes a chance correlation for a real one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats, checked, count_draws
from rrmctl.stats.bootstrap import REPLICATES, Estimate, Statistic, estimate, interval_possible, resample

Strata = Sequence[npt.ArrayLike]


def difference(
    ours: Strata,
    theirs: Strata,
    statistic: Statistic,
    *,
    rng: np.random.Generator,
    paired: bool = False,
    replicates: int = REPLICATES,
    level: float = 0.95,
) -> Estimate:
    """The statistic of our runs minus that of theirs, each pooled over tasks, and its percentile interval.

    Args as of `rrmctl.stats.bootstrap`; `paired`: the runs of one row belong together, and are drawn together.
    """
    sizes = _sizes(ours, theirs)
    if paired and any(a != b for a, b in sizes):
        raise ValueError("paired runs come in pairs: both methods need the same seeds on every task")
    both = (ours, theirs)
    point, other = (statistic(np.concatenate([checked(task, axis=0) for task in runs], axis=-1)) for runs in both)
    draws = None
    if interval_possible([size for pair in sizes for size in pair]):
        seeds = rng.integers(2**63, size=2)
        rngs = map(np.random.default_rng, seeds[[0, 0]] if paired else seeds)  # those with one seed draw the same rows
        draws = np.subtract(
            *(resample(runs, statistic, rng=own, replicates=replicates) for runs, own in zip(both, rngs, strict=True))
        )
    apart = estimate(point - other, draws, n=sum(map(sum, sizes)), level=level)
    return apart if draws is None else apart.noting("pairs of one seed drawn together" if paired else "unpaired")


def probability_of_improvement(ours: Strata, theirs: Strata) -> float:
    """The probability that a run of ours beats one of theirs on the same task, averaged over tasks; ties count half.

    The Mann-Whitney statistic over the number of pairs (Agarwal et al. 2021, as in rliable), of one score a run. Every
    run of one method is compared with every run of the other: seeds are no pairs here.
    """
    return float(np.mean([wins.mean() for wins in _wins(ours, theirs)]))


def improvement(
    ours: Strata,
    theirs: Strata,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    level: float = 0.95,
) -> Estimate:
    """`probability_of_improvement` with its percentile interval, both methods resampled within each task."""
    if replicates < 1:
        raise ValueError(f"a bootstrap needs at least one replicate, not {replicates}")
    tasks, draws = _wins(ours, theirs), None
    sizes = [size for wins in tasks for size in wins.shape]
    if interval_possible(sizes):
        shares = []
        for wins in tasks:  # of wins in each replicate, from how often it drew each run
            a, b = (count_draws([rng.integers(n, size=(replicates, n), dtype=np.int32)]) for n in wins.shape)
            shares.append(np.einsum("ar,ab,br->r", a, wins, b, optimize=True) / wins.size)
        draws = np.mean(shares, axis=0)
    return estimate(np.mean([wins.mean() for wins in tasks]), draws, n=sum(sizes), level=level)


def _wins(ours: Strata, theirs: Strata) -> list[Floats]:
    """Of each task, 1 where the run of ours [row] beats that of theirs [column], 1/2 where they are level: [S, S']."""
    _sizes(ours, theirs)
    pairs = [[checked(scores, axis=0) for scores in pair] for pair in zip(ours, theirs, strict=True)]
    if any(scores.ndim != 1 for pair in pairs for scores in pair):
        raise ValueError("runs are compared by one score each")
    return [np.asarray((np.sign(a[:, None] - b) + 1.0) / 2.0) for a, b in pairs]


def _sizes(ours: Strata, theirs: Strata) -> list[tuple[int, int]]:
    """Runs of both methods on each task."""
    if not ours or len(ours) != len(theirs):
        raise ValueError(f"two methods are compared on the same tasks, not on {len(ours)} and {len(theirs)}")
    return [(len(np.atleast_1d(a)), len(np.atleast_1d(b))) for a, b in zip(ours, theirs, strict=True)]
