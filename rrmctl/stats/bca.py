"""Bias-corrected and accelerated (BCa) levels of a bootstrap interval (Efron 1987).

The percentile interval takes the replicates' quantiles at 2.5 % and 97.5 %. BCa moves these two levels: by how far the
estimate lies from the replicates' median, and by how fast the spread of the statistic changes with its value, which is
read from the estimates without one run each. With several strata each run is left out of its own stratum and compared
with the others left out there.

It needs a statistic that changes smoothly with the runs: means and interquartile means, not medians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np

from rrmctl.stats.aggregate import Floats

_NORMAL = NormalDist()
_cdf = np.vectorize(_NORMAL.cdf, otypes=[np.float64])
_inverse = np.vectorize(_NORMAL.inv_cdf, otypes=[np.float64])


def left_out(runs: Sequence[Floats], statistic: Callable[[Floats], Floats]) -> list[Floats]:
    """For each stratum [..., S] the statistic of all runs pooled but one of that stratum, [S, ...]."""
    pooled = np.concatenate(runs, axis=-1)
    sizes = [each.shape[-1] for each in runs]
    values = np.stack([statistic(np.delete(pooled, run, axis=-1)) for run in range(sum(sizes))])
    return np.split(values, np.cumsum(sizes)[:-1])


def bca_levels(point: Floats, draws: Floats, without: Sequence[Floats], level: float) -> Floats:
    """Where among the replicates the interval's two ends lie.

    Args:
        point: the estimate, [...].
        draws: its replicates, [R, ...].
        without: of `left_out`, [S, ...] for each stratum.
        level: nominal coverage.

    Returns:
        float64 [2, ...] in (0, 1); NaN where BCa is not defined: all replicates on one side of the estimate, no
        difference whichever run is left out, or a correction beyond any level.
    """
    below = ((draws < point).mean(axis=0) + (draws <= point).mean(axis=0)) / 2  # ties count by half
    known = (below > 0.0) & (below < 1.0)
    bias = _inverse(np.where(known, below, 0.5))
    acceleration = _acceleration(without)
    tail = (1.0 - level) / 2.0
    ends = np.array([_NORMAL.inv_cdf(tail), _NORMAL.inv_cdf(1.0 - tail)]).reshape(2, *[1] * point.ndim)
    slope = 1.0 - acceleration * (bias + ends)
    known = known & np.isfinite(acceleration) & (slope > 0.0).all(axis=0)
    shifted = bias + (bias + ends) / np.where(known, slope, 1.0)
    return np.where(known, _cdf(shifted), np.nan)


def quantiles_at(draws: Floats, levels: Floats) -> Floats:
    """The quantile of [R, ...] at a level of its own for each entry, [K, ...]; linear between replicates."""
    ordered = np.sort(draws, axis=0)
    place = levels * (len(draws) - 1)
    before = np.floor(place).astype(np.intp)
    after = np.minimum(before + 1, len(draws) - 1)
    low, high = (np.take_along_axis(ordered, each, axis=0) for each in (before, after))
    return np.asarray(low + (high - low) * (place - before))


def _acceleration(without: Sequence[Floats]) -> Floats:
    """A sixth of the influences' skewness; NaN where no run has any."""
    influence = [(len(each) - 1) * (each.mean(axis=0) - each) / len(each) for each in without]
    cubes = np.sum([(each**3).sum(axis=0) for each in influence], axis=0)
    squares = np.sum([(each**2).sum(axis=0) for each in influence], axis=0)
    any_influence = squares > 0.0
    return np.where(any_influence, cubes / np.where(any_influence, 6.0 * squares**1.5, 1.0), np.nan)
