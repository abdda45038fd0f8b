"""The counted replicates beside two references: resample-and-sort of this program, and scipy's trimmed mean."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import trim_mean

from rrmctl.stats import Iqm, bootstrap, iqm, resample
from rrmctl.stats.aggregate import count_draws, iqm_weights, iqm_window

KINDS = ("rliable", "exact")


def rng(seed=0):
    return np.random.default_rng(seed)


def both(strata, kind, **options):
    """The same draws, counted and sorted."""
    counted = resample(strata, Iqm(kind), rng=rng(7), **options)
    by_sorting = resample(strata, partial(iqm, kind=kind, axis=-1), rng=rng(7), **options)
    return counted, by_sorting


@st.composite
def matrices(draw):
    """Scores of one to four tasks with one to nine runs each, curves of one to four steps; often tied or saturated."""
    steps = draw(st.integers(1, 4))
    score = draw(st.sampled_from([st.floats(-1e3, 1e3), st.sampled_from([0.0, 0.1, 0.7, 1.0]), st.just(0.7)]))
    run = st.lists(score, min_size=steps, max_size=steps)
    return [np.array(each) for each in draw(st.lists(st.lists(run, min_size=1, max_size=9), min_size=1, max_size=4))]


@settings(deadline=None)
@given(matrices(), st.sampled_from(KINDS))
def test_counting_and_sorting_agree(strata, kind):
    """The same draws give equal replicates: any scores, ties, strata of unequal size, a single run, both kinds."""
    counted, by_sorting = both(strata, kind, replicates=20)
    assert counted.shape == by_sorting.shape == (20, strata[0].shape[1])
    largest = max(np.abs(each).max() for each in strata)
    np.testing.assert_allclose(counted, by_sorting, rtol=1e-12, atol=1e-13 * largest)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sizes", [[3], [10] * 8, [63], [64], [65], [130, 126], [255, 2], [300, 1, 4]])
def test_no_count_outgrows_its_type(sizes, kind):
    """Below, at and above the numbers of draws at which counts, whole or in quarters, need a wider type."""
    counted, by_sorting = both([rng(n).random(n) for n in sizes], kind, replicates=50)
    np.testing.assert_allclose(counted, by_sorting, rtol=1e-12)


def test_a_run_that_is_drawn_every_time_is_counted():
    """A stratum of one run is drawn once in every replicate."""
    np.testing.assert_array_equal(count_draws([np.zeros((4, 1), np.int32)]), [[1, 1, 1, 1]])


def test_draws_are_counted_by_stratum():
    """Two replicates of three and two runs: rows are runs, stratum after stratum."""
    picks = [np.array([[0, 0, 2], [1, 1, 1]], np.int32), np.array([[1, 0], [1, 1]], np.int32)]
    np.testing.assert_array_equal(count_draws(picks), [[2, 0], [0, 3], [1, 0], [1, 0], [1, 2]])


def test_the_draws_come_from_the_stream_stratum_by_stratum():
    """Whoever draws the runs from the same generator gets the same replicates, by scipy's trimmed mean."""
    strata, stream = [rng(1).random(5), rng(2).random(8)], rng(3)
    picks = [stream.integers(each.size, size=(30, each.size), dtype=np.int32) for each in strata]
    pooled = np.concatenate([each[pick] for each, pick in zip(strata, picks, strict=True)], axis=1)
    found = resample(strata, Iqm(), rng=rng(3), replicates=30)
    np.testing.assert_allclose(found, trim_mean(pooled, 0.25, axis=1), rtol=1e-12)


def test_runs_may_have_scores_of_any_shape():
    """What follows the runs' axis keeps its shape, here [2, 3]."""
    counted, by_sorting = both([rng(1).random((5, 2, 3)), rng(2).random((4, 2, 3))], "rliable", replicates=11)
    assert counted.shape == (11, 2, 3)
    np.testing.assert_allclose(counted, by_sorting, rtol=1e-12)


@pytest.mark.parametrize("score", [0.0, 0.1, 0.7, 1.0, 1e300, 5e-324])
@pytest.mark.parametrize("kind", KINDS)
def test_equal_scores_stay_exactly_what_they_are(score, kind):
    """All seeds alike: every replicate is that score to the last digit, so the interval has no width."""
    found = bootstrap([np.full((7, 2), score), np.full((3, 2), score)], Iqm(kind), rng=rng(), replicates=100)
    np.testing.assert_array_equal(found.low, [score] * 2)
    np.testing.assert_array_equal(found.high, [score] * 2)


def test_a_trimmed_outlier_leaves_no_trace():
    """Scores far outside are dropped before anything is added up: their size costs no digit."""
    runs = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1e17])
    counted, by_sorting = both([runs], "rliable", replicates=200)
    unharmed = by_sorting < 1.0
    assert unharmed.any()
    np.testing.assert_allclose(counted[unharmed], by_sorting[unharmed], rtol=1e-12)


def test_the_size_of_chunks_changes_nothing_but_rounding():
    """One replicate at a time or all at once."""
    strata = [rng(1).random((5, 7)), rng(2).random((4, 7))]
    whole = resample(strata, Iqm(), rng=rng(), replicates=101)
    pieces = resample(strata, Iqm(), rng=rng(), replicates=101, chunk_bytes=1)
    np.testing.assert_allclose(whole, pieces, rtol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", range(1, 30))
def test_the_window_is_as_long_as_the_weights_add_up_to(n, kind):
    """Its ends lie on quarters, as far from the first run as from the last."""
    low, high = iqm_window(n, kind)
    assert high - low == iqm_weights(n, kind).sum()
    assert low + high == n
    assert (4 * low).is_integer()


def test_an_unknown_kind_is_refused():
    """A misspelt kind names the known ones."""
    with pytest.raises(ValueError, match="known: rliable, exact"):
        resample([[1.0, 2.0, 3.0]], Iqm("trimmed"), rng=rng(), replicates=1)
