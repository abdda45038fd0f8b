"""Statistics over runs: plain arrays in, small frozen results out. Imports nothing but numpy."""

from rrmctl.stats.aggregate import Floats, Iqm, IqmKind, Steps, iqm, mean, median, optimality_gap, quartiles
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
from rrmctl.stats.curves import CommonStep, area_under_curve, common_step, performance_profile, read_at_common_step
from rrmctl.stats.sequential import Comparison, Decision, Design, Outlook, Standing, outlook, sequential_test

__all__ = [
    "MIN_RUNS", "REPLICATES", "CommonStep", "Comparison", "Decision", "Design", "Estimate", "Floats", "IntervalKind",
    "Iqm", "IqmKind", "Outlook", "Standing", "Steps", "area_under_curve", "bootstrap", "common_step", "difference",
    "estimate", "improvement", "interval_possible", "iqm", "mean", "median", "optimality_gap", "outlook",
    "performance_profile", "probability_of_improvement", "quartiles", "read_at_common_step", "resample",
    "sequential_test",
]  # fmt: skip
