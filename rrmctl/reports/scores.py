"""Numbers read off curves, with the resampled data sets behind their intervals.

What is read of a series is a matrix [S, T]: for each seed its values at some steps, one step included. The number is
the mean over these steps of the interquartile mean over seeds. Of several tasks it is the mean of theirs; tasks that
are read at one step each may be pooled instead, as rliable does: one interquartile mean of all their seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from rrmctl.errors import UserError
from rrmctl.reports.series import Series
from rrmctl.reports.statistics import BOOTSTRAP_SEED, LEVEL, Statistics
from rrmctl.stats import Estimate, Floats, Iqm, Steps, estimate, interval_possible, resample
from rrmctl.stats.bootstrap import Statistic


@dataclass(frozen=True, eq=False)
class Score:
    """A number and its replicates."""

    point: float
    draws: Floats  #: [R]; a NaN where a task has too few seeds for an interval
    n: int  #: fewest seeds of a task, of both methods where it is a difference

    def __sub__(self, other: Score) -> Score:
        """The difference between two methods, each resampled on its own."""
        return Score(self.point - other.point, self.draws - other.draws, min(self.n, other.n))

    def estimate(self, level: float = LEVEL) -> Estimate:
        """With its percentile interval."""
        draws = None if np.isnan(self.draws).all() else self.draws
        return estimate(self.point, draws, n=self.n, level=level)


def score(
    tasks: Sequence[Floats],
    settings: Statistics,
    *,
    pooled: bool = False,
    stream: int = 0,
    statistic: Statistic | None = None,
) -> Score:
    """The number behind what was read of one method on each task.

    Args:
        tasks: for each task [S, T]; none is empty.
        pooled: all seeds are of one number, rather than those of each task; T is the same for all tasks.
        stream: of random numbers; two methods to be compared are resampled from two.
        statistic: of the seeds, in place of the interquartile mean.
    """
    middle = statistic or Iqm(settings.kind)
    rng, sizes = np.random.default_rng([BOOTSTRAP_SEED, stream] if stream else BOOTSTRAP_SEED), list(map(len, tasks))
    groups = [tasks] if pooled else [[values] for values in tasks]
    points = [middle(np.concatenate(group).T).mean() for group in groups]
    draws = np.full(1, np.nan)
    if interval_possible(sizes):
        drawn = [resample(group, middle, rng=rng, replicates=settings.replicates) for group in groups]
        draws = np.asarray(np.mean([replicates.mean(axis=-1) for replicates in drawn], axis=0))
    return Score(float(np.mean(points)), draws, min(sizes))


def common_steps(series: Sequence[Series]) -> Steps:
    """The steps that all of these series of one task have; refused without any."""
    steps = reduce(np.intersect1d, (one.steps for one in series))
    if not steps.size:
        task = series[0].label.task
        raise UserError(f"{task}: no evaluation step is common to all schedules and methods", "let the runs go on")
    return steps
