from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from rrmctl.stats import (
    Iqm,
    difference,
    improvement,
    mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
)

last_mean = partial(mean, axis=-1)
runs = st.lists(st.sampled_from([0.0, 0.1, 0.5, 0.7, 1.0]), min_size=1, max_size=8)


def rng(seed=0):
    return np.random.default_rng(seed)


@given(runs, runs)
def test_the_improvement_on_one_task_is_mann_whitneys(ours, theirs):
    """The U statistic over the number of pairs, ties by half, whatever the runs."""
    expected = mannwhitneyu(ours, theirs, alternative="greater").statistic / (len(ours) * len(theirs))
    assert probability_of_improvement([ours], [theirs]) == pytest.approx(expected)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(runs, runs), min_size=1, max_size=3))
def test_what_one_gains_the_other_loses(tasks):
    """The two probabilities of a pair of methods add up to one."""
    ours, theirs = zip(*tasks, strict=True)
    assert probability_of_improvement(ours, theirs) + probability_of_improvement(theirs, ours) == pytest.approx(1)


def test_tasks_count_alike_whatever_their_runs():
    """One task that is always won with many runs, one always lost with few: one half."""
    assert probability_of_improvement([np.ones(40), np.zeros(3)], [np.zeros(40), np.ones(5)]) == 0.5


def test_the_interval_of_the_improvement_is_the_enumerated_one():
    """Three against three runs: all 27 x 27 equally likely resamples, by brute force."""
    ours, theirs = np.array([0.2, 0.5, 0.9]), np.array([0.1, 0.5, 0.6])
    exact = [probability_of_improvement([a], [b]) for a in product(ours, repeat=3) for b in product(theirs, repeat=3)]
    found = improvement([ours], [theirs], rng=rng(), replicates=40_000, level=0.8)
    np.testing.assert_allclose([found.low, found.high], np.quantile(exact, [0.1, 0.9]), atol=1e-9)
    assert found.n == 6


def test_saturated_methods_are_level():
    """All seeds of both at 100 %: one half, no width, no difference."""
    both = [np.ones(5)], [np.ones(4)]
    found = improvement(*both, rng=rng(), replicates=100)
    assert (found.estimate, found.low, found.high) == (0.5, 0.5, 0.5)
    found = difference(*both, Iqm(), rng=rng(), replicates=100)
    assert (found.estimate, found.low, found.high) == (0.0, 0.0, 0.0)


def test_the_difference_of_means_has_the_enumerated_interval():
    """Three against three runs resampled apart."""
    ours, theirs = np.array([0.2, 0.5, 0.9]), np.array([0.1, 0.45, 0.6])
    exact = [np.mean(a) - np.mean(b) for a in product(ours, repeat=3) for b in product(theirs, repeat=3)]
    found = difference([ours], [theirs], last_mean, rng=rng(), replicates=60_000)
    np.testing.assert_allclose([found.low, found.high], np.quantile(exact, [0.025, 0.975]), atol=0.02)
    assert "unpaired" in found.method


def test_pairs_are_drawn_together():
    """A difference that every pair shares has no width when paired, and has one when not."""
    theirs = [rng(1).random(6), rng(2).random(4)]
    ours = [each + 0.25 for each in theirs]
    paired = difference(ours, theirs, last_mean, rng=rng(), replicates=500, paired=True)
    np.testing.assert_allclose([paired.low, paired.high], 0.25, rtol=1e-12)
    assert "pairs" in paired.method
    apart = difference(ours, theirs, last_mean, rng=rng(), replicates=500)
    assert apart.low < 0.2 < 0.3 < apart.high


def test_equal_scores_are_no_pairs():
    """Unpaired resampling draws for the two methods by themselves, even where their runs are the same numbers."""
    same = [rng(1).random(8)]
    found = difference(same, same, last_mean, rng=rng(), replicates=500)
    assert found.low < 0.0 < found.high


def test_differences_may_be_of_whole_curves():
    """One difference for each step, from the same resampled runs."""
    found = difference([rng(1).random((5, 3))], [rng(2).random((4, 3))], Iqm(), rng=rng(), replicates=200)
    assert found.low.shape == (3,)
    assert (found.low <= found.high).all()


@pytest.mark.parametrize("function", [partial(difference, statistic=Iqm()), improvement])
def test_fewer_than_three_runs_of_either_get_no_interval(function):
    """The estimate stands, the interval does not, and the method says why."""
    found = function([[0.1, 0.2, 0.3]], [[0.4, 0.5]], rng=rng())
    assert np.isfinite(found.estimate)
    assert np.isnan(found.low)
    assert "fewer than 3" in found.method


def test_the_gap_ignores_what_is_beyond_the_target():
    """Runs above the target do not make up for those below."""
    assert float(optimality_gap([0.5, 1.0, 3.0])) == pytest.approx(0.5 / 3)
    np.testing.assert_allclose(optimality_gap([[10.0, 0.0], [30.0, 40.0]], 20.0, axis=0), [5.0, 10.0])


def test_a_profile_falls_from_one_to_zero():
    """Scores at the threshold are not above it; saturated tasks and unequal numbers of runs crash nothing."""
    found = performance_profile([np.ones(3), [0.0, 0.5, 0.5, 1.0]], [-0.1, 0.0, 0.5, 1.0], rng=rng(), replicates=100)
    np.testing.assert_allclose(found.estimate, [1.0, 6 / 7, 4 / 7, 0.0])
    assert (found.low <= found.estimate).all()
    assert (found.low[0], found.high[0], found.low[3], found.high[3]) == (1.0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: difference([], [], Iqm(), rng=rng()), "same tasks"),
        (lambda: improvement([[1.0]], [[1.0], [2.0]], rng=rng()), "same tasks"),
        (lambda: difference([[1.0] * 3], [[1.0] * 4], Iqm(), rng=rng(), paired=True), "come in pairs"),
        (lambda: probability_of_improvement([[float("nan")]], [[1.0]]), "not finite"),
        (lambda: probability_of_improvement([np.ones((3, 2))], [np.ones((3, 2))]), "one score each"),
        (lambda: improvement([[1.0] * 3], [[1.0] * 3], rng=rng(), replicates=0), "replicate"),
        (lambda: optimality_gap([1.0], float("inf")), "finite"),
        (lambda: performance_profile([np.ones((3, 2))], [0.5], rng=rng()), "one score for each run"),
    ],
)
def test_bad_comparisons_are_refused(call, message):
    """Different tasks, lone pairs, missing scores and impossible options raise."""
    with pytest.raises(ValueError, match=message):
        call()
