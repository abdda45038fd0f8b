from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import bootstrap as scipy_bootstrap
from scipy.stats import trim_mean

from rrmctl.stats import Iqm, area_under_curve, bootstrap, iqm, mean, resample

last_iqm = partial(iqm, axis=-1)
last_mean = partial(mean, axis=-1)


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("statistic", [last_iqm, Iqm()], ids=["sorted", "counted"])
def test_replicates_follow_the_enumerated_distribution(statistic):
    """Two strata of three and two runs: all 27 x 4 resamples occur, each value as often as enumeration says."""
    strata = [np.array([0.0, 1.0, 5.0]), np.array([2.0, 9.0])]
    exact = [
        float(trim_mean([*a, *b], 0.25)) for a in product(strata[0], repeat=3) for b in product(strata[1], repeat=2)
    ]
    values, counts = np.unique(np.round(exact, 9), return_counts=True)
    draws = np.round(resample(strata, statistic, rng=rng(), replicates=40_000), 9)
    found, frequency = np.unique(draws, return_counts=True)
    np.testing.assert_array_equal(found, values)
    share = counts / counts.sum()
    error = np.sqrt(share * (1 - share) / draws.size)
    assert (np.abs(frequency / draws.size - share) < 5 * error).all()


def test_the_interval_is_that_of_the_enumerated_distribution():
    """Four runs, 256 equally likely resamples: the interval's ends are the enumerated percentiles."""
    runs = np.array([0.1, 0.3, 0.4, 0.9])
    exact = [np.mean(each) for each in product(runs, repeat=4)]
    found = bootstrap([runs], last_mean, rng=rng(), replicates=50_000)
    np.testing.assert_allclose([found.low, found.high], np.quantile(exact, [0.025, 0.975]), atol=0.011)
    assert float(found.estimate) == pytest.approx(0.425)
    assert found.n == 4


def test_the_interval_agrees_with_scipys_percentile_bootstrap():
    """One stratum of thirty runs: within Monte-Carlo error of scipy.stats.bootstrap."""
    runs = rng(3).normal(size=30)
    ours = bootstrap([runs], last_mean, rng=rng(1))
    theirs = scipy_bootstrap(
        (runs,), np.mean, n_resamples=10_000, method="percentile", rng=rng(2), batch=1000
    ).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], atol=0.02)


def test_strata_keep_their_sizes():
    """Resampling never moves runs between tasks: each replicate's mean keeps both tasks' constant values."""
    draws = resample([np.full(3, 10.0), np.full(1, 2.0)], last_mean, rng=rng(), replicates=50)
    np.testing.assert_array_equal(draws, np.full(50, 8.0))


def test_a_run_is_drawn_with_its_whole_curve():
    """Runs whose values add up to one at every pair of steps still do in every replicate."""
    first = np.array([0.1, 0.4, 0.8])
    curves = np.stack([first, 1 - first], axis=1)
    draws = resample([curves], last_mean, rng=rng(), replicates=200)
    assert draws.shape == (200, 2)
    np.testing.assert_allclose(draws.sum(axis=1), 1.0)
    np.testing.assert_allclose(area_under_curve([0, 10], draws), 0.5)


def test_the_size_of_chunks_changes_nothing():
    """Bounding the memory does not change the draws."""
    strata = [rng(1).random((5, 7)), rng(2).random((4, 7))]
    whole = resample(strata, last_iqm, rng=rng(), replicates=101)
    pieces = resample(strata, last_iqm, rng=rng(), replicates=101, chunk_bytes=1)
    np.testing.assert_array_equal(whole, pieces)


def test_the_same_generator_gives_the_same_bytes():
    """The explicit generator is the only randomness."""
    runs = [rng(5).random(6)]
    one, two = (bootstrap(runs, last_iqm, rng=rng(9), replicates=500) for _ in range(2))
    assert (one.low, one.high) == (two.low, two.high)


@pytest.mark.parametrize("sizes", [[1], [2], [5, 2]])
def test_fewer_than_three_runs_get_no_interval(sizes):
    """A stratum with one or two runs leaves the estimate without interval, and says so."""
    found = bootstrap([np.linspace(0, 1, n) for n in sizes], last_iqm, rng=rng())
    assert np.isnan(found.low)
    assert np.isnan(found.high)
    assert np.isfinite(found.estimate)
    assert "fewer than 3" in found.method


def test_saturated_runs_have_an_interval_of_no_width():
    """All seeds at 100 %: nothing crashes and both ends are exactly 1."""
    found = bootstrap([np.ones((10, 3)), np.ones((3, 3))], last_iqm, rng=rng(), replicates=100)
    for part in (found.estimate, found.low, found.high):
        np.testing.assert_array_equal(part, np.ones(3))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(st.floats(0, 1), min_size=3, max_size=8), min_size=1, max_size=4))
def test_the_interval_stays_within_the_scores(strata):
    """A percentile interval of a bounded score never leaves its bounds, and its ends are in order."""
    found = bootstrap(strata, last_iqm, rng=rng(), replicates=100)
    everything = [score for each in strata for score in each]
    assert min(everything) - 1e-12 <= found.low <= found.high <= max(everything) + 1e-12


@pytest.mark.parametrize(
    ("strata", "message"),
    [
        ([], "no strata"),
        ([[]], "no scores"),
        ([[0.1, float("nan"), 0.2]], "not finite"),
        ([np.ones((3, 2)), np.ones((3, 4))], "one shape"),
    ],
)
def test_bad_strata_are_refused(strata, message):
    """Missing, torn or mismatched scores raise instead of being averaged."""
    with pytest.raises(ValueError, match=message):
        bootstrap(strata, last_iqm, rng=rng())


@pytest.mark.parametrize("options", [{"replicates": 0}, {"level": 1.0}])
def test_bad_options_are_refused(options):
    """No replicates and an impossible level raise."""
    with pytest.raises(ValueError, match=r"replicate|level"):
        bootstrap([[1.0, 2.0, 3.0]], last_iqm, rng=rng(), **options)
