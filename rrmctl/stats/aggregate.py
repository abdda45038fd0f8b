"""Point estimates over runs: interquartile mean, mean, median, optimality gap and the quartile band.

One run contributes one number, so a caller averages episodes first. What is not finite is refused: a missing
measurement must be dealt with where it is known which run it belongs to.
"""

from __future__ import annotations

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


def iqm(scores: npt.ArrayLike, kind: IqmKind = "rliable", *, axis: int | None = None) -> Floats:
    """Interquartile mean along an axis, or of all entries pooled (rliable's definition for runs x tasks).

    Args:
        scores: finite numbers, any shape, at least one along the axis.
        kind: see `IqmKind`.
        axis: the runs; None pools everything.

    Returns:
        float64 of the remaining shape (0-d for `axis=None`).

    Raises:
        ValueError: no scores, a score that is not finite, or an unknown kind.
    """
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
    """Mean along an axis or of everything; refuses what `iqm` refuses."""
    return np.asarray(checked(scores, axis).mean(axis=-1))


def median(scores: npt.ArrayLike, *, axis: int | None = None) -> Floats:
    """Median along an axis or of everything; refuses what `iqm` refuses."""
    return np.asarray(np.median(checked(scores, axis), axis=-1))


def optimality_gap(scores: npt.ArrayLike, target: float = 1.0, *, axis: int | None = None) -> Floats:
    """By how much the runs miss a target on average; a run beyond the target counts as at it (as in rliable).

    Raises:
        ValueError: what `iqm` refuses, or a target that is not finite.
    """
    if not np.isfinite(target):
        raise ValueError(f"a target is a finite score, not {target}")
    return target - np.asarray(np.minimum(checked(scores, axis), target).mean(axis=-1))


def quartiles(scores: npt.ArrayLike, *, axis: int | None = None) -> tuple[Floats, Floats]:
    """The 25th and 75th percentile, linearly interpolated between runs: the band of a learning curve.

    It describes the spread of the runs and is no confidence interval.
    """
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
