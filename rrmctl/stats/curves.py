"""What is read off learning curves: the area below, the step at which methods are compared, and a profile there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats, Steps, checked, count_draws, mean
from rrmctl.stats.bootstrap import REPLICATES, Estimate, bootstrap

#: Of the seeds: how many must be at 100 % for a task to be read there.
SHARE = 0.8


def area_under_curve(steps: npt.ArrayLike, values: npt.ArrayLike) -> Floats:
    """Mean height of curves [..., T] between their first and last step (trapezoids): [...], in the values' unit.

    The steps [T] strictly increase; of a single one it is the value itself.
    """
    x = checked_steps(steps)
    y = checked(values, axis=-1)
    if y.shape[-1] != x.size:
        raise ValueError(f"{x.size} steps and {y.shape[-1]} values do not belong together")
    if x.size == 1:
        return np.asarray(y[..., 0])
    return np.asarray(np.trapezoid(y, x, axis=-1) / (x[-1] - x[0]))


@dataclass(frozen=True)
class CommonStep:
    """The step at which the methods of a task are read."""

    index: int  #: position among the evaluation steps
    step: int  #: environment steps
    reached: bool  #: False: no method got there and this is merely the last step
    by: tuple[str, ...]  #: the methods that got there first


def common_step(steps: npt.ArrayLike, success: Mapping[str, npt.ArrayLike]) -> CommonStep:
    """First evaluation step at which `SHARE` of the seeds of any of these methods are at 100 % success.

    The rule of the paper's box figure (8 of 10 seeds). A step chosen on the data it is then applied to flatters the
    method by which it was chosen; `read_at_common_step` has that in its intervals. The last step, where none gets
    there, flatters nobody.

    Args:
        steps: evaluation steps common to all methods, [T].
        success: method (none that knows the true reward) -> share of successful episodes of each run, [S, T].
    """
    x = checked_steps(steps)
    first: dict[str, int] = {}
    for method, scores in success.items():
        values = checked(scores, axis=0)
        if values.shape[:-1] != x.shape:
            raise ValueError(f"{method}: {x.size} steps and scores of shape {np.shape(scores)} do not belong together")
        if values.min() < 0.0 or values.max() > 1.0:
            raise ValueError(f"{method}: success is a fraction between 0 and 1")
        enough = _enough((values >= 1.0).sum(axis=-1), values.shape[-1])
        if enough.any():
            first[method] = int(enough.argmax())
    index = min(first.values(), default=x.size - 1)
    by = tuple(method for method, position in first.items() if position == index)
    return CommonStep(index=index, step=int(x[index]), reached=bool(first), by=by)


def read_at_common_step(
    success: Mapping[str, npt.ArrayLike],
    values: Mapping[str, npt.ArrayLike],
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
) -> dict[str, Floats]:
    """For each method the values of the runs that each replicate drew, [R, S], at a step chosen by these same draws.

    Of two methods alike the one that happens to be the first at 100 % stands higher at that step. With a step for each
    replicate, by the rule of `common_step`, it is now the one and now the other.

    Args:
        success: as `common_step` takes it.
        values: method -> what is read of each of its runs at each step, [S, T]; those in `success` have the same runs.
    """
    sizes = {method: len(np.asarray(scores)) for method, scores in {**success, **values}.items()}
    picks = {method: rng.integers(size, size=(replicates, size), dtype=np.int32) for method, size in sizes.items()}
    last = next(iter(values.values()))
    first = np.full(replicates, np.shape(last)[-1] - 1)
    for method, scores in success.items():
        at_top = (checked(scores, axis=0) >= 1.0).T  # [S, T]
        drawn = count_draws([picks[method]]).T  # how often, [R, S]
        enough = _enough(drawn.astype(np.float32) @ at_top.astype(np.float32), sizes[method])
        first = np.where(enough.any(axis=-1), np.minimum(first, enough.argmax(axis=-1)), first)
    return {method: np.asarray(scores)[picks[method], first[:, None]] for method, scores in values.items()}


def _enough(at_top: npt.ArrayLike, runs: int) -> npt.NDArray[np.bool_]:
    """Whether so many of the runs are enough at 100 %."""
    # The slack is for shares like 0.8 * 35, which floating point puts a hair above 28.
    return np.asarray(at_top, dtype=np.float64) >= SHARE * runs - 1e-4


def checked_steps(steps: npt.ArrayLike) -> Steps:
    """The steps as int64 [T]; refused where there are none or they do not strictly increase."""
    x = np.asarray(steps, dtype=np.int64)
    if x.ndim != 1 or x.size == 0:
        raise ValueError("a curve needs at least one evaluation step")
    if (np.diff(x) <= 0).any():
        raise ValueError("evaluation steps must increase from one to the next")
    return x


def performance_profile(
    strata: Sequence[npt.ArrayLike],
    thresholds: npt.ArrayLike,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    level: float = 0.95,
) -> Estimate:
    """Share of all runs, tasks pooled, that score above each threshold, with a pointwise percentile band.

    The run-score distribution of Agarwal et al. 2021, as in rliable: a score equal to the threshold is not above it.
    `level` is the coverage at each threshold by itself; the band as a whole covers less.

    Args:
        strata: for each task one score a run, [S].
        thresholds: [T], finite, as are the arrays of the result.
    """
    levels, runs = checked(thresholds, axis=0), [checked(scores, axis=0) for scores in strata]
    if levels.ndim != 1 or any(scores.ndim != 1 for scores in runs):
        raise ValueError("a profile needs a list of thresholds and one score for each run")
    above = [scores[:, None] > levels for scores in runs]
    return bootstrap(above, partial(mean, axis=-1), rng=rng, replicates=replicates, level=level)
