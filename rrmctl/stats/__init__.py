"""Statistics over runs: plain arrays in, small frozen results out. Imports nothing but numpy."""

from rrmctl.stats.aggregate import Iqm, IqmKind, iqm, mean, median, optimality_gap, quartiles
from rrmctl.stats.bootstrap import (
    MIN_RUNS,
    REPLICATES,
    Estimate,
    IntervalKind,
    bootstrap,
    estimate,
    interval_possible,
    resample,
)
from rrmctl.stats.compare import difference, improvement, probability_of_improvement
from rrmctl.stats.curves import CommonStep, area_under_curve, common_step
from rrmctl.stats.profiles import performance_profile

__all__ = [
    "MIN_RUNS",
    "REPLICATES",
    "CommonStep",
    "Estimate",
    "IntervalKind",
    "Iqm",
    "IqmKind",
    "area_under_curve",
    "bootstrap",
    "common_step",
    "difference",
    "estimate",
    "improvement",
    "interval_possible",
    "iqm",
    "mean",
    "median",
    "optimality_gap",
    "performance_profile",
    "probability_of_improvement",
    "quartiles",
    "resample",
]
