"""Performance profiles: which share of the runs scores above a threshold, for every threshold."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import checked, mean
from rrmctl.stats.bootstrap import REPLICATES, Estimate, bootstrap


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

    Args:
        strata: for each task one score a run, [S].
        thresholds: finite, [T].
        rng: the only source of randomness.
        replicates: resampled data sets.
        level: nominal coverage at each threshold by itself; the band as a whole covers less.

    Returns:
        arrays [T].

    Raises:
        ValueError: as `rrmctl.stats.bootstrap`; thresholds that are no finite list; more than one score a run.
    """
    levels, runs = checked(thresholds, axis=0), [checked(each, axis=0) for each in strata]
    if levels.ndim != 1 or any(each.ndim != 1 for each in runs):
        raise ValueError("a profile needs a list of thresholds and one score for each run")
    above = [each[:, None] > levels for each in runs]
    return bootstrap(above, partial(mean, axis=-1), rng=rng, replicates=replicates, level=level)
