from functools import partial

import numpy as np
import pytest
from scipy.stats import bootstrap as scipy_bootstrap
from scipy.stats import trim_mean

from rrmctl.stats import Iqm, bootstrap, iqm, mean, resample
from rrmctl.stats.bootstrap import bca_levels, left_out, quantiles_at

last_mean = partial(mean, axis=-1)


def rng(seed=0):
    return np.random.default_rng(seed)


def scipys(runs, statistic, replicates):
    return scipy_bootstrap(
        (runs,), statistic, n_resamples=replicates, method="BCa", rng=rng(2), batch=1000, axis=-1, vectorized=True
    ).confidence_interval


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(last_mean, np.mean), (Iqm(), lambda runs, axis: trim_mean(runs, 0.25, axis=axis))],
    ids=["mean", "iqm"],
)
@pytest.mark.parametrize("runs", [rng(3).exponential(size=25), rng(4).beta(5, 1, size=10)], ids=["skewed", "bounded"])
def test_the_interval_agrees_with_scipys(ours, theirs, runs):
    """One stratum of skewed runs: within Monte-Carlo error of scipy, and apart from the percentile interval."""
    found = bootstrap([runs], ours, rng=rng(1), replicates=40_000, kind="bca")
    other = scipys(runs, theirs, 40_000)
    # Ends of 40,000 replicates: five errors of a quantile, both programs drawing.
    draws = resample([runs], ours, rng=rng(5), replicates=40_000)
    for end, reference in ((found.low, other.low), (found.high, other.high)):
        assert abs((draws < end).mean() - (draws < reference).mean()) < 5 * np.sqrt(2 * 0.025 * 0.975 / 40_000)
    percentile = bootstrap([runs], ours, rng=rng(1), replicates=40_000)
    assert not np.isclose(found.low, percentile.low, rtol=1e-3)
    assert "BCa" in found.method


def test_levels_are_scipys_to_the_last_digit():
    """Given scipy's own replicates, the interval is scipy's interval: levels, acceleration, ties and interpolation."""
    runs = rng(4).binomial(10, 0.8, 12) / 10
    theirs = scipy_bootstrap((runs,), np.mean, n_resamples=2000, method="BCa", rng=rng(2), batch=100)
    draws = theirs.bootstrap_distribution
    levels = bca_levels(np.asarray(runs.mean()), draws, left_out([runs], last_mean), 0.95)
    interval = theirs.confidence_interval
    np.testing.assert_allclose(quantiles_at(draws, levels), [interval.low, interval.high], rtol=1e-10)


def test_strata_are_left_out_one_run_each_and_compared_within():
    """Two tasks on different levels: a shift of one task changes no level, as the mean's influence is the run's own."""
    one, two = rng(1).exponential(size=8), rng(2).exponential(size=8)

    def levels(shift):
        strata = [one, two + shift]
        draws = resample(strata, last_mean, rng=rng(3), replicates=2000)
        return bca_levels(last_mean(np.concatenate(strata)), draws, left_out(strata, last_mean), 0.95)

    np.testing.assert_allclose(levels(0.0), levels(100.0), atol=1e-9)


def test_leaving_out_a_run_is_the_statistic_without_it():
    """Each entry is the statistic of the others of all strata, in the order of the strata."""
    first, second = left_out([np.array([0.0, 1.0, 5.0]), np.array([2.0, 9.0])], last_mean)
    np.testing.assert_allclose(first, [17 / 4, 16 / 4, 12 / 4])
    np.testing.assert_allclose(second, [15 / 4, 8 / 4])


def test_saturated_runs_fall_back_to_the_percentile_interval_and_say_so():
    """All seeds at 100 %: no width, no crash, no claim of BCa."""
    found = bootstrap([np.ones(10), np.ones(5)], Iqm(), rng=rng(), replicates=200, kind="bca")
    assert (found.low, found.high) == (1.0, 1.0)
    assert found.method.startswith("95 % percentile")
    assert "BCa is not defined" in found.method


def test_a_curve_that_saturates_falls_back_where_it_does():
    """Each step has its own levels; the method counts the steps without."""
    curve = np.stack([rng(1).random(9), np.ones(9), rng(2).random(9)], axis=1)
    found = bootstrap([curve], Iqm(), rng=rng(), replicates=500, kind="bca")
    assert "percentile for 1 of 3 numbers" in found.method
    alone = bootstrap([curve[:, 0]], Iqm(), rng=rng(), replicates=500, kind="bca")
    np.testing.assert_allclose([found.low[0], found.high[0]], [alone.low, alone.high])
    assert (found.low[1], found.high[1]) == (1.0, 1.0)


def test_one_outlier_beyond_the_replicates_leaves_the_percentile_interval():
    """Replicates all on one side of the estimate: no level corrects for that."""
    levels = bca_levels(np.asarray(2.0), rng().random(50), [np.array([0.1, 0.5, 0.9])], 0.95)
    assert np.isnan(levels).all()


def test_fewer_than_three_runs_get_no_interval_here_either():
    """The kind changes nothing about that."""
    found = bootstrap([[0.1, 0.9]], Iqm(), rng=rng(), kind="bca")
    assert np.isnan(found.low)
    assert "fewer than 3" in found.method


def test_an_unknown_kind_is_refused():
    """A misspelt kind names the known ones."""
    with pytest.raises(ValueError, match="known: percentile, bca"):
        bootstrap([[1.0, 2.0, 3.0]], iqm, rng=rng(), kind="basic")
