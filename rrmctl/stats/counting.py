"""Replicates of an interquartile mean, none of which is sorted.

A replicate is how often it drew each run. The scores are sorted once for all replicates; adding the counts up in that
order says where, among the replicate's ordered draws, those of each score begin and end, and the part of them between
the quartiles is the score's weight. In a curve only the order differs from one step to the next. Counts are small whole
numbers, so one instruction of the processor adds dozens of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats, IqmKind, iqm_window

#: The runs that each replicate drew from a stratum, [R, S].
Picks = npt.NDArray[np.int32]

#: Whole numbers from zero up, of the narrowest type that holds what they can add up to.
Counts = npt.NDArray[np.unsignedinteger]


def count_draws(picks: Sequence[Picks]) -> Counts:
    """How often each replicate drew each run of all strata: [R, S] each, to [sum of S, R]."""
    draws = sum(pick.shape[1] for pick in picks)
    counts: Counts = np.empty((draws, len(picks[0])), np.min_scalar_type(draws))
    rows = iter(counts)
    for pick in picks:
        drawn = np.ascontiguousarray(pick.T, dtype=np.min_scalar_type(pick.shape[1]))
        for run in range(pick.shape[1]):
            np.add.reduce(drawn == run, axis=0, dtype=counts.dtype, out=next(rows))
    return counts


def iqm_replicates(scores: Floats, counts: Counts, kind: IqmKind) -> Floats:
    """The interquartile mean of each replicate.

    Args:
        scores: of all runs, [..., N].
        counts: of `count_draws`, [N, R]; each replicate drew N times.
        kind: see `IqmKind`.

    Returns:
        float64 [..., R].
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
