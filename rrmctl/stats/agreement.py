"""How far people agree: with one another, with a known truth, with themselves; and what a sitting does to them.

Krippendorff's alpha for nominal values with gaps (Computing Krippendorff's Alpha-Reliability, 2011), Cohen's kappa
(1960), shares with Wilson's interval (1927), differences of two with Newcombe's (1998, method 10). Intervals of alpha
and kappa are percentile bootstraps over units, for the same people: what was asked is resampled, who answered is not.
What does not exist, such as the agreement beyond chance on units whose values are all alike, is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats
from rrmctl.stats.bootstrap import REPLICATES, Estimate, Statistic, estimate, interval_possible, resample

#: Answers behind a slope's unit.
HUNDRED = 100


def alpha(
    ratings: npt.ArrayLike, *, rng: np.random.Generator, replicates: int = REPLICATES, level: float = 0.95
) -> Estimate:
    """Krippendorff's alpha of ratings [units, people], nominal, NaN where somebody was not asked.

    `n` is the number of units with two ratings or more; the others say nothing.
    """
    values = np.asarray(ratings, np.float64)
    counts = (values[:, :, None] == np.unique(values[~np.isnan(values)])).sum(axis=1)
    return _over_units(counts[counts.sum(axis=1) > 1], _alpha, rng, replicates, level)


def _alpha(counts: Floats) -> Floats:
    """Of counts [values, ..., units], each unit of two ratings or more."""
    raters, totals = counts.sum(axis=0), counts.sum(axis=-1)
    observed = ((raters**2 - (counts**2).sum(axis=0)) / (raters - 1)).sum(axis=-1)
    ratings = totals.sum(axis=0)
    return _beyond_chance(observed, (ratings**2 - (totals**2).sum(axis=0)) / (ratings - 1))


def kappa(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    level: float = 0.95,
) -> Estimate:
    """Cohen's kappa of two people's ratings [units], nominal; units that lack one of them (NaN) are left out."""
    one, other = np.asarray(first, np.float64), np.asarray(second, np.float64)
    both = ~np.isnan(one) & ~np.isnan(other)
    one, other = one[both, None, None], other[both, None, None]
    known = np.unique([one, other])
    return _over_units((one == known[:, None]) & (other == known), _kappa, rng, replicates, level)


def _kappa(pairs: Floats) -> Floats:
    """Of ones [values, values, ..., units] where first and second say so."""
    table = pairs.mean(axis=-1)
    expected = (table.sum(axis=0) * table.sum(axis=1)).sum(axis=0)
    return _beyond_chance(1.0 - np.trace(table), 1.0 - expected)


def _beyond_chance(observed: Floats, expected: Floats) -> Floats:
    """One less observed over expected disagreement."""
    return np.where(expected > 0, 1.0 - observed / np.where(expected > 0, expected, 1.0), np.nan)


def _over_units(
    units: npt.NDArray[np.generic], statistic: Statistic, rng: np.random.Generator, replicates: int, level: float
) -> Estimate:
    """The statistic of units [n, ...]; replicates in which it does not exist do not count."""
    data, draws = units.astype(np.float64), None
    point = statistic(np.moveaxis(data, 0, -1)) if len(data) else np.array(np.nan)
    if np.isfinite(point) and interval_possible([len(data)]):
        draws = resample([data], statistic, rng=rng, replicates=replicates)
        draws = draws[np.isfinite(draws)]
    return estimate(point, draws, n=len(data), level=level)


def share(hits: npt.ArrayLike, level: float = 0.95) -> Estimate:
    """How many of n are true, as a share; NaN of none."""
    values = np.asarray(hits, np.float64)
    n, z = values.size, NormalDist().inv_cdf((1.0 + level) / 2.0)
    name = f"{100 * level:g} % Wilson interval"
    if not n:
        return Estimate(np.array(np.nan), np.array(np.nan), np.array(np.nan), n, name)
    middle = values.mean()
    half = z * np.sqrt(middle * (1.0 - middle) / n + z**2 / (4.0 * n**2))
    low, high = ((middle + z**2 / (2.0 * n) + side * half) / (1.0 + z**2 / n) for side in (-1, 1))
    return Estimate(np.asarray(middle), np.asarray(low), np.asarray(high), n, name)


def apart(one: Estimate, other: Estimate) -> Estimate:
    """The first of two independent shares less the second."""
    (p, below, above), (q, under, over) = ((each.estimate, each.low, each.high) for each in (one, other))
    low, high = p - q - np.hypot(p - below, over - q), p - q + np.hypot(above - p, q - under)
    return Estimate(np.asarray(p - q), np.asarray(low), np.asarray(high), one.n + other.n, "Newcombe's interval")


def slope(
    sittings: Sequence[npt.ArrayLike], *, rng: np.random.Generator, replicates: int = REPLICATES, level: float = 0.95
) -> Estimate:
    """How much a number changes per hundred answers along a sitting: least squares within sittings.

    Args:
        sittings: for each of them the number at each answer in its order; NaN where there is none.
    """
    points = []
    for values in (np.asarray(sitting, np.float64) for sitting in sittings):
        known = np.flatnonzero(~np.isnan(values))
        if known.size > 1:
            points.append(np.stack([known / HUNDRED - known.mean() / HUNDRED, values[known] - values[known].mean()], 1))
    return _over_units(np.concatenate([np.empty((0, 2)), *points]), _slope, rng, replicates, level)


def _slope(points: Floats) -> Floats:
    """Of positions and values [2, ..., n], either centred in its sitting."""
    spread = (points[0] ** 2).sum(axis=-1)
    return np.where(spread > 0, (points[0] * points[1]).sum(axis=-1) / np.where(spread > 0, spread, 1.0), np.nan)


class Bin(NamedTuple):
    """Answers at like values of something."""

    middle: float  #: the median of it
    share: Estimate


def binned(values: npt.ArrayLike, hits: npt.ArrayLike, bins: int) -> list[Bin]:
    """The share of hits in so many bins of equally many values, fewer where there are fewer values; lowest first."""
    x, true = np.asarray(values, np.float64), np.asarray(hits, np.float64)
    parts = np.array_split(np.argsort(x, kind="stable"), max(1, min(bins, x.size)))
    return [Bin(float(np.median(x[part])), share(true[part])) for part in parts if part.size]


def expected_width(
    people: int, shared: int, right: float, *, rng: np.random.Generator, studies: int = 400, replicates: int = 400
) -> float:
    """Mean width of alpha's 95 % interval where everybody answers the same queries, right with this probability."""
    widths = []
    for _ in range(studies):
        truth, correct = rng.random((shared, 1)) < 0.5, rng.random((shared, people)) < right
        found = alpha(truth == correct, rng=rng, replicates=replicates)
        widths.append(float(found.high - found.low))
    return float(np.nanmean(widths))
