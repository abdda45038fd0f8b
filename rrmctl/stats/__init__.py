"""Statistics over runs: plain arrays in, small frozen results out. Imports nothing but numpy."""

from rrmctl.stats.aggregate import Iqm, IqmKind, iqm, mean, median, quartiles
from rrmctl.stats.bootstrap import MIN_RUNS, REPLICATES, Estimate, bootstrap, estimate, interval_possible, resample
from rrmctl.stats.curves import CommonStep, area_under_curve, common_step

__all__ = [
    "MIN_RUNS",
    "REPLICATES",
    "CommonStep",
    "Estimate",
    "Iqm",
    "IqmKind",
    "area_under_curve",
    "bootstrap",
    "common_step",
    "estimate",
    "interval_possible",
    "iqm",
    "mean",
    "median",
    "quartiles",
    "resample",
]
