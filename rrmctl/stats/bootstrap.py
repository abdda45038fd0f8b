"""Stratified bootstrap over runs, with tasks as strata: percentile intervals, and BCa.

Within each task whole runs are drawn with replacement, independently of the other tasks, and the statistic is taken
of all of them pooled (Agarwal et al. 2021, as in rliable). A run is drawn with its whole curve, so that the replicates
of neighbouring steps belong together and the area under the curve has an interval too.

The percentile interval takes the replicates' quantiles at 2.5 % and 97.5 %. BCa (Efron 1987, docs/statistics.md) moves
these levels: by how far the estimate lies from the replicates' median, and by how fast the spread of the statistic
changes with its value, which is read from the estimates without one run each. It needs a statistic that changes
smoothly with the runs: means and interquartile means, not medians.

A ValueError refuses what cannot be resampled: no strata, an empty one, shapes that differ beyond the runs, a score that
is not finite, no replicates, or a level that is not between 0 and 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats, Iqm, checked, count_draws, iqm_replicates

#: Reduces the last axis, which holds the runs. Any function will do; of an `Iqm` the replicates come much quicker.
Statistic = Callable[[Floats], Floats]

#: How an interval is read off the replicates: their quantiles at the usual levels, or at those of BCa.
IntervalKind = Literal["percentile", "bca"]

#: Fewer runs than this in any stratum say nothing about spread; such an estimate gets no interval.
MIN_RUNS = 3
REPLICATES = 10_000


@dataclass(frozen=True)
class Estimate:
    """A statistic with its interval; arrays have the shape of one run's score (0-d for a number per run)."""

    estimate: Floats
    low: Floats  #: NaN where there are too few runs for an interval
    high: Floats
    n: int  #: runs, over all strata
    method: str  #: how the interval was made, or why there is none

    def row(self, name: str, ends: str = "") -> dict[str, float]:
        """A single number by this name, and its interval's ends, whose names begin with another."""
        return {name: float(self.estimate), f"{ends}low": float(self.low), f"{ends}high": float(self.high)}

    def noting(self, remark: str) -> Estimate:
        """The same, its method followed by a remark."""
        return replace(self, method=f"{self.method}, {remark}")


def bootstrap(
    strata: Sequence[npt.ArrayLike],
    statistic: Statistic,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    level: float = 0.95,
    kind: IntervalKind = "percentile",
) -> Estimate:
    """The statistic of all runs pooled, and its interval.

    Args:
        strata: for each task the finite scores of its runs, [S] or [S, ...]; tasks may have different numbers of runs.
        statistic: reduces the last axis of an array.
        rng: the only source of randomness.
        replicates: resampled data sets.
        level: nominal coverage; the true one is lower for few runs.
        kind: BCa is meant for smooth statistics, and where it is not defined (saturated runs) the percentile interval
            stands in and `method` says so.
    """
    if kind not in get_args(IntervalKind):
        raise ValueError(f"unknown interval {kind!r}; known: {', '.join(get_args(IntervalKind))}")
    runs = _runs_last(strata)
    draws = None
    if interval_possible([stratum.shape[-1] for stratum in runs]):
        draws = resample(strata, statistic, rng=rng, replicates=replicates)
    pooled = np.concatenate(runs, axis=-1)
    plain = estimate(statistic(pooled), draws, n=pooled.shape[-1], level=level)
    if kind == "percentile" or draws is None:
        return plain
    return _bias_corrected(plain, draws, bca_levels(plain.estimate, draws, left_out(runs, statistic), level))


def estimate(point: npt.ArrayLike, draws: Floats | None, *, n: int, level: float = 0.95) -> Estimate:
    """Wrap a statistic and its replicates [R, ...]; None stands for "too few runs" and leaves NaN as the interval."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"the level of an interval lies between 0 and 1, not {level}")
    value = np.asarray(point, dtype=np.float64)
    if draws is None:
        none = np.full(value.shape, np.nan)
        return Estimate(value, none, none, n, f"no interval: fewer than {MIN_RUNS} runs")
    tail = (1.0 - level) / 2.0
    low, high = np.quantile(draws, [tail, 1.0 - tail], axis=0)
    method = f"{100 * level:g} % percentile bootstrap, {draws.shape[0]:,} replicates"
    return Estimate(value, np.asarray(low), np.asarray(high), n, method)


def interval_possible(sizes: Sequence[int]) -> bool:
    """True where every stratum has enough runs for an interval."""
    return min(sizes, default=0) >= MIN_RUNS


def resample(
    strata: Sequence[npt.ArrayLike],
    statistic: Statistic,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    chunk_bytes: int = 2**20,  # what stays in a core's cache is read again at once
) -> Floats:
    """The statistic of each resampled data set, float64 [R, ...].

    Memory is bounded by `chunk_bytes` for each copy of the data it makes; the result depends on it, and on whether an
    `Iqm` or an equal function is given, by rounding alone.
    """
    if replicates < 1:
        raise ValueError(f"a bootstrap needs at least one replicate, not {replicates}")
    runs = _runs_last(strata)
    # All draws come first: the stream must not depend on the size of the chunks.
    sizes = [stratum.shape[-1] for stratum in runs]
    picks = [rng.integers(size, size=(replicates, size), dtype=np.int32) for size in sizes]
    if isinstance(statistic, Iqm):  # from how often each replicate drew each run; a count takes a byte or two, copied
        scores, counts, kind = np.concatenate(runs, axis=-1), count_draws(picks), statistic.kind
        size = 4 * len(counts)

        def part(chunk: slice) -> Floats:
            return iqm_replicates(scores, counts[:, chunk], kind)
    else:
        size = 8 * sum(stratum.size for stratum in runs)

        def part(chunk: slice) -> Floats:
            drawn = [np.take(stratum, pick[chunk], axis=-1) for stratum, pick in zip(runs, picks, strict=True)]
            return statistic(np.concatenate(drawn, axis=-1))

    length = max(1, chunk_bytes // size)
    parts = [part(slice(start, start + length)) for start in range(0, replicates, length)]
    return np.moveaxis(np.concatenate(parts, axis=-1), -1, 0)


def _runs_last(strata: Sequence[npt.ArrayLike]) -> list[Floats]:
    if not strata:
        raise ValueError("no strata to resample")
    runs = [checked(scores, axis=0) for scores in strata]
    if len({stratum.shape[:-1] for stratum in runs}) > 1:
        raise ValueError("the scores of all strata need one shape beyond the runs")
    return runs


_NORMAL = NormalDist()
_cdf = np.vectorize(_NORMAL.cdf, otypes=[np.float64])
_inverse = np.vectorize(_NORMAL.inv_cdf, otypes=[np.float64])


def _bias_corrected(plain: Estimate, draws: Floats, levels: Floats) -> Estimate:
    """The percentile estimate with its ends moved to these levels [2, ...], where there are any."""
    defined = np.isfinite(levels).all(axis=0)
    low, high = np.where(defined, quantiles_at(draws, np.where(defined, levels, 0.5)), (plain.low, plain.high))
    moved = replace(plain, low=low, high=high, method=plain.method.replace("percentile", "BCa"))
    if defined.all():
        return moved
    why = "BCa is not defined: all replicates on one side of it, or no run that makes a difference"
    if not defined.any():
        return plain.noting(why)
    return moved.noting(f"percentile for {defined.size - defined.sum()} of {defined.size} numbers where {why}")


def left_out(runs: Sequence[Floats], statistic: Callable[[Floats], Floats]) -> list[Floats]:
    """For each stratum [..., S] the statistic of all runs pooled but one of that stratum, [S, ...]."""
    pooled = np.concatenate(runs, axis=-1)
    sizes = [stratum.shape[-1] for stratum in runs]
    values = np.stack([statistic(np.delete(pooled, run, axis=-1)) for run in range(sum(sizes))])
    return np.split(values, np.cumsum(sizes)[:-1])


def bca_levels(point: Floats, draws: Floats, without: Sequence[Floats], level: float) -> Floats:
    """Where among the replicates [R, ...] of an estimate the interval's two ends lie: [2, ...] in (0, 1).

    It is NaN where BCa is not defined: all replicates on one side of the estimate, no difference whichever run is left
    out (`without`, of `left_out`), or a correction beyond any level.
    """
    below = ((draws < point).mean(axis=0) + (draws <= point).mean(axis=0)) / 2  # ties count by half
    defined = (below > 0.0) & (below < 1.0)
    bias = _inverse(np.where(defined, below, 0.5))
    influences = [(len(left) - 1) * (left.mean(axis=0) - left) / len(left) for left in without]
    cubes, squares = (np.sum([(u**power).sum(axis=0) for u in influences], axis=0) for power in (3, 2))
    defined &= squares > 0.0
    acceleration = cubes / np.where(squares > 0.0, 6.0 * squares**1.5, 1.0)  # a sixth of the influences' skewness
    tail = (1.0 - level) / 2.0
    ends = np.array([_NORMAL.inv_cdf(tail), _NORMAL.inv_cdf(1.0 - tail)]).reshape(2, *[1] * point.ndim)
    slope = 1.0 - acceleration * (bias + ends)
    defined &= (slope > 0.0).all(axis=0)
    shifted = bias + (bias + ends) / np.where(defined, slope, 1.0)
    return np.where(defined, _cdf(shifted), np.nan)


def quantiles_at(draws: Floats, levels: Floats) -> Floats:
    """The quantile of [R, ...] at a level of its own for each entry, [K, ...]; linear between replicates."""
    ordered = np.sort(draws, axis=0)
    place = levels * (len(draws) - 1)
    before = np.floor(place).astype(np.intp)
    after = np.minimum(before + 1, len(draws) - 1)
    low, high = (np.take_along_axis(ordered, row, axis=0) for row in (before, after))
    return np.asarray(low + (high - low) * (place - before))
