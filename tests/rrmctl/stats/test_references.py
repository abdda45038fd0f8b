"""Beside rliable: its values are stored in references/rliable.json with the script that made them."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from rrmctl.stats import (
    Iqm,
    bootstrap,
    improvement,
    iqm,
    mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
    resample,
)

STORED = json.loads((Path(__file__).parent / "references" / "rliable.json").read_text())
CASES = STORED["cases"]
STATISTICS = {"iqm": Iqm(), "mean": partial(mean, axis=-1), "optimality_gap": partial(optimality_gap, axis=-1)}
TAILS = (0.025, 0.975)


def tasks(case, whose="ours"):
    """Runs x tasks as rliable has them, as one stratum a task."""
    return list(np.array(CASES[case][whose]).T)


def within_chance(ends, draws):
    """Rliable's ends lie where an end of as many replicates as it drew may lie by chance, five errors wide."""
    for tail, end in zip(TAILS, ends, strict=True):
        slack = 5 * np.sqrt(tail * (1 - tail) * (1 / len(draws) + 1 / STORED["replicates"]))
        low, high = np.quantile(draws, [max(0, tail - slack), min(1, tail + slack)], axis=0)
        assert (low - 1e-9 <= end).all()
        assert (end <= high + 1e-9).all()


@pytest.mark.parametrize("case", CASES)
def test_point_estimates_are_rliables(case):
    """IQM, mean, optimality gap and probability of improvement to the last digits."""
    ours, theirs = tasks(case), tasks(case, "theirs")
    assert float(iqm(np.array(ours))) == pytest.approx(CASES[case]["iqm"][0], rel=1e-12)
    assert float(mean(np.array(ours))) == pytest.approx(CASES[case]["mean"][0], rel=1e-12)
    assert float(optimality_gap(np.array(ours))) == pytest.approx(CASES[case]["optimality_gap"][0], abs=1e-12)
    assert probability_of_improvement(ours, theirs) == pytest.approx(CASES[case]["improvement"][0], rel=1e-12)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", STATISTICS)
def test_intervals_are_rliables(case, name):
    """The stratified percentile interval, within the Monte-Carlo error of both programs."""
    draws = resample(tasks(case), STATISTICS[name], rng=np.random.default_rng(1), replicates=20_000)
    within_chance(CASES[case][name][1:], draws)


@pytest.mark.parametrize("case", CASES)
def test_the_interval_of_the_improvement_is_rliables(case):
    """At five levels around each end, whose replicates our function does not give away, rliable's lies between."""
    ours, theirs = tasks(case), tasks(case, "theirs")
    error = 5 * np.sqrt(0.025 * 0.975 * 2 / STORED["replicates"])
    wide, narrow = (
        improvement(ours, theirs, rng=np.random.default_rng(1), replicates=20_000, level=0.95 + sign * 2 * error)
        for sign in (1, -1)
    )
    low, high = CASES[case]["improvement"][1:]
    assert wide.low - 1e-9 <= low <= narrow.low + 1e-9
    assert narrow.high - 1e-9 <= high <= wide.high + 1e-9


@pytest.mark.parametrize("case", CASES)
def test_profiles_are_rliables(case):
    """The share of runs above each threshold exactly, the band within Monte-Carlo error."""
    thresholds = CASES[case]["thresholds"]
    point, *band = np.array(CASES[case]["profile"])
    found = performance_profile(tasks(case), thresholds, rng=np.random.default_rng(1), replicates=1000)
    np.testing.assert_allclose(found.estimate, point, rtol=1e-12)
    above = [each[:, None] > np.array(thresholds) for each in tasks(case)]
    draws = resample(above, partial(mean, axis=-1), rng=np.random.default_rng(2), replicates=20_000)
    within_chance(band, draws)
    again = bootstrap(above, partial(mean, axis=-1), rng=np.random.default_rng(1), replicates=1000)
    np.testing.assert_array_equal([found.low, found.high], [again.low, again.high])
