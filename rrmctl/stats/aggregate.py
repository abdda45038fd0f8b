"""Point estimates over runs: interquartile mean, mean, median, optimality gap and the quartile band.

One run contributes one number, so a caller averages episodes first. All are taken along an axis of runs, or of
everything pooled (rliable's definition for runs x tasks), and come as float64 of the remaining shape. A ValueError
refuses what has no scores, or one that is not finite: a missing measurement must be dealt with where it is known which
run it belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

#: Which interquartile mean. `rliable` drops floor(n / 4) whole runs at each end, as rliable and scipy's `trim_mean` do
#: (of ten runs the middle six remain); `exact` weighs the two runs that straddle a quartile by the share inside it (of
#: ten runs four count fully and two by half).
IqmKind = Literal["rliable", "exact"]

#: Whole numbers from zero up, of the narrowest type that holds what they can add up to.
Counts = npt.NDArray[np.unsignedinteger]


def iqm(scores: npt.ArrayLike, kind: IqmKind = "rliable", *, axis: int | None = None) -> Floats:
    """Interquartile mean."""
    values = checked(scores, axis)
    weights = iqm_weights(values.shape[-1], kind)
    used = np.flatnonzero(weights)
    inside = slice(used[0], used[-1] + 1)
    # Dividing by the sum at the end keeps saturated scores exactly saturated: the weights are multiples of 1/4.
    return np.asarray((np.sort(values, axis=-1)[..., inside] * weights[inside]).sum(axis=-1) / weights.sum())


@dataclass(frozen=True)
class Iqm:
    """`iqm` of the last axis, as a statistic that the bootstrap knows by name and need not call for every replicate."""

    kind: IqmKind = "rliable"

    def __call__(self, scores: Floats) -> Floats:
        return iqm(scores, self.kind, axis=-1)


def iqm_weights(n: int, kind: IqmKind) -> Floats:
    """Weight of each of `n` ordered runs, float64 [n], not normalised."""
    low, high = iqm_window(n, kind)
    place = np.arange(n, dtype=np.float64)
    inside: Floats = np.minimum(place + 1, high) - np.maximum(place, low)
    return inside.clip(0.0, 1.0)


def iqm_window(n: int, kind: IqmKind) -> tuple[float, float]:
    """Where the mean begins and ends when each of `n` ordered runs takes up a length of one; multiples of 1/4."""
    if n < 1:
        raise ValueError("an interquartile mean needs at least one score")
    if kind == "rliable":
        return float(n // 4), float(n - n // 4)
    if kind == "exact":
        return 0.25 * n, 0.75 * n
    raise ValueError(f"unknown interquartile mean {kind!r}; known: {', '.join(get_args(IqmKind))}")


def mean(scores: npt.ArrayLike, *, axis: int | None = None) -> Floats:
    """Mean."""
    return np.asarray(checked(scores, axis).mean(axis=-1))


def median(scores: npt.ArrayLike, *, axis: int | None = None) -> Floats:
    """Median."""
    return np.asarray(np.median(checked(scores, axis), axis=-1))


def optimality_gap(scores: npt.ArrayLike, target: float = 1.0, *, axis: int | None = None) -> Floats:
    """By how much the runs miss a finite target on average; a run beyond it counts as at it (as in rliable)."""
    if not np.isfinite(target):
        raise ValueError(f"a target is a finite score, not {target}")
    return target - np.asarray(np.minimum(checked(scores, axis), target).mean(axis=-1))


def quartiles(scores: npt.ArrayLike, *, axis: int | None = None) -> tuple[Floats, Floats]:
    """The 25th and 75th percentile, linear between runs: the band of a learning curve, and no confidence interval."""
    low, high = np.quantile(checked(scores, axis), [0.25, 0.75], axis=-1)
    return np.asarray(low), np.asarray(high)


def checked(scores: npt.ArrayLike, axis: int | None = None) -> Floats:
    """The scores as float64 with the runs on the last axis; refused where there are none or one is not finite."""
    values = np.asarray(scores, dtype=np.float64)
    values = values.reshape(-1) if axis is None else np.moveaxis(values, axis, -1)
    if values.shape[-1] == 0:
        raise ValueError("no scores to aggregate")
    bad = values.size - int(np.isfinite(values).sum())
    if bad:
        raise ValueError(f"{bad} of {values.size} scores are not finite; leave those runs out by name, not by accident")
    return values


def count_draws(picks: Sequence[npt.NDArray[np.int32]]) -> Counts:
    """How often each replicate drew each run of all strata, from the runs [R, S] that it drew: [sum of S, R]."""
    draws = sum(pick.shape[1] for pick in picks)
    counts: Counts = np.empty((draws, len(picks[0])), np.min_scalar_type(draws))
    rows = iter(counts)
    for pick in picks:
        drawn = np.ascontiguousarray(pick.T, dtype=np.min_scalar_type(pick.shape[1]))
        for run in range(pick.shape[1]):
            np.add.reduce(drawn == run, axis=0, dtype=counts.dtype, out=next(rows))
    return counts


def iqm_replicates(scores: Floats, counts: Counts, kind: IqmKind) -> Floats:
    """The interquartile mean of each replicate, none of which is sorted: [..., R].

    Of all runs' scores [..., N], and how often each replicate drew each, [N, R]. The scores are sorted once for all
    replicates; adding the counts up in that order says where, among the replicate's ordered draws, those of each score
    begin and end, and the part of them between the quartiles is the score's weight. In a curve only the order differs
    from one step to the next. Counts are small whole numbers, so one instruction of the processor adds dozens of them.
    """
    n, replicates = counts.shape
    low, high = iqm_window(n, kind)
    parts = next(parts for parts in (1, 2, 4) if (parts * low).is_integer())  # of a draw: quartiles fall between two
    low, high = int(parts * low), int(parts * high)
    rows = list(counts if parts == 1 else counts.astype(np.min_scalar_type(parts * n)) * np.uint8(parts))
    order = np.argsort(scores, axis=-1)
    ordered = np.take_along_axis(scores, order, axis=-1)
    ends, inside = np.zeros((2, n + 1, replicates), rows[0].dtype)  # where the draws of each score end, from zero on
    weights = np.empty((n, replicates), rows[0].dtype)
    means = np.empty((*scores.shape[:-1], replicates))
    for at in np.ndindex(means.shape[:-1]):
        before = ends[0]  # zero
        for run, end in zip(order[at], ends[1:], strict=True):
            before = np.add(before, rows[run], out=end)
        np.clip(ends, low, high, out=inside)
        np.subtract(inside[1:], inside[:-1], out=weights)
        np.einsum("n,nr->r", ordered[at], weights, out=means[at])  # a matrix product would copy the weights to floats
    means /= high - low
    # A mean lies between the scores; rounding must not move that of equal scores away from them.
    return np.clip(means, ordered[..., :1], ordered[..., -1:], out=means)
