import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import trim_mean

from rrmctl.stats import iqm, mean, median, quartiles
from rrmctl.stats.aggregate import iqm_weights

scores = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40)
kinds = st.sampled_from(["rliable", "exact"])


@given(scores)
def test_the_rliable_iqm_is_scipys_trimmed_mean(values):
    """For any number of runs the rliable kind equals scipy's trim_mean at 25 %."""
    np.testing.assert_allclose(iqm(values), trim_mean(values, 0.25), rtol=1e-12, atol=1e-9)


def test_the_kinds_differ_with_ten_runs():
    """Ten runs: rliable averages the middle six, exact counts the third and the eighth by half."""
    runs = [0, 0, 0, 1, 2, 3, 4, 10, 100, 1000]
    assert iqm(runs, "rliable") == pytest.approx(20 / 6)
    assert iqm(runs, "exact") == pytest.approx((1 + 2 + 3 + 4 + 0.5 * 10) / 5)


@pytest.mark.parametrize("n", [4, 8, 12, 40])
def test_the_kinds_agree_where_a_quarter_is_whole(n):
    """With a multiple of four runs both kinds keep exactly the middle half."""
    runs = np.random.default_rng(n).normal(size=n)
    np.testing.assert_allclose(iqm(runs, "rliable"), iqm(runs, "exact"))


@pytest.mark.parametrize("n", range(1, 30))
def test_exact_weights_keep_half_of_the_runs(n):
    """The fractional weights are symmetric and add up to half of the runs."""
    weights = iqm_weights(n, "exact")
    assert weights.sum() == pytest.approx(n / 2)
    np.testing.assert_allclose(weights, weights[::-1])


@pytest.mark.parametrize("kind", ["rliable", "exact"])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 7, 10, 13])
def test_saturated_scores_stay_exactly_saturated(kind, n):
    """All runs at 100 % give exactly 1, so that a comparison with 1 is safe."""
    assert iqm(np.ones(n), kind) == 1.0


@given(scores, kinds, st.randoms(use_true_random=False))
def test_order_shift_and_range(values, kind, random):
    """The IQM ignores the order of runs, follows a shift and lies between the extremes."""
    value = float(iqm(values, kind))
    shuffled = random.sample(values, len(values))
    assert value == float(iqm(shuffled, kind))
    assert min(values) - 1e-9 <= value <= max(values) + 1e-9
    assert float(iqm(np.array(values) + 5.0, kind)) == pytest.approx(value + 5.0, abs=1e-9)


@given(st.lists(st.floats(0, 1), min_size=5, max_size=20), kinds)
def test_a_better_run_never_lowers_the_iqm(values, kind):
    """The IQM is monotone in every run."""
    better = [*values[1:], values[0] + 0.5]
    assert float(iqm(better, kind)) >= float(iqm(values, kind)) - 1e-12


def test_without_an_axis_runs_and_tasks_are_pooled():
    """A matrix of runs x tasks is one pool, as in rliable's aggregate_iqm."""
    matrix = np.arange(24.0).reshape(8, 3) ** 2
    assert float(iqm(matrix)) == pytest.approx(trim_mean(matrix, 0.25, axis=None))


def test_along_an_axis_every_step_is_its_own():
    """With axis=0 each column of [S, T] is aggregated by itself."""
    curves = np.random.default_rng(0).random((10, 4))
    np.testing.assert_allclose(iqm(curves, axis=0), trim_mean(curves, 0.25, axis=0))
    np.testing.assert_allclose(mean(curves, axis=0), curves.mean(axis=0))
    np.testing.assert_allclose(median(curves, axis=0), np.median(curves, axis=0))


def test_quartiles_interpolate_linearly():
    """Four runs 0, 1, 2, 3 have their quartiles at 0.75 and 2.25."""
    assert [float(q) for q in quartiles([3, 0, 2, 1])] == [0.75, 2.25]


@pytest.mark.parametrize("function", [iqm, mean, median, quartiles])
@pytest.mark.parametrize("bad", [[], [0.5, float("nan")], [0.5, float("inf")]])
def test_nothing_and_not_finite_are_refused(function, bad):
    """No estimator averages over missing measurements or over nothing."""
    with pytest.raises(ValueError, match=r"no scores|not finite"):
        function(bad)


def test_an_unknown_kind_is_refused():
    """A misspelt kind names the known ones."""
    with pytest.raises(ValueError, match="known: rliable, exact"):
        iqm([1.0], "trimmed")
