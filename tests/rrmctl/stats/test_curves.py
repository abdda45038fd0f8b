import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrmctl.stats import area_under_curve, common_step, read_at_common_step

STEPS = [100, 200, 300]


def runs(*rows):
    return np.array(rows, dtype=float)


def test_the_area_is_the_mean_height():
    """A triangle of height 2 has a mean height of 1, whatever its width; uneven steps weigh by their width."""
    assert float(area_under_curve([0, 50, 100], [0, 2, 0])) == 1.0
    assert float(area_under_curve([0, 10, 100], [1, 1, 3])) == pytest.approx((10 * 1 + 90 * 2) / 100)


def test_a_single_step_is_its_own_area():
    """One evaluation has no width; its value stands for the curve."""
    assert float(area_under_curve([500], [0.7])) == 0.7


def test_many_curves_are_integrated_at_once():
    """Leading axes are curves."""
    np.testing.assert_allclose(area_under_curve([0, 1], [[0, 2], [4, 6]]), [1, 5])


@given(st.lists(st.floats(0, 1), min_size=2, max_size=10), st.floats(1, 1000))
def test_the_area_ignores_the_unit_of_steps(values, scale):
    """Counting steps in thousands changes nothing, and the area lies within the curve."""
    steps = np.arange(1, len(values) + 1)
    area = float(area_under_curve(steps, values))
    assert area == pytest.approx(float(area_under_curve(steps * int(scale), values)))
    assert min(values) - 1e-12 <= area <= max(values) + 1e-12


def test_the_common_step_is_the_first_at_which_four_of_five_are_there():
    """Four of five seeds of one method at 100 % set the step for all."""
    pebble = runs(*[[0, 0, 1]] * 5)
    rrm = runs(*[[0, 1, 1]] * 4, [0, 0, 0])
    found = common_step(STEPS, {"pebble": pebble, "rrm-proxy": rrm})
    assert (found.index, found.step, found.reached, found.by) == (1, 200, True, ("rrm-proxy",))


def test_where_none_gets_there_it_is_the_last_step():
    """Flagged as such."""
    found = common_step(STEPS, {"pebble": runs(*[[0, 1, 0.9]] * 3, *[[0, 0, 0]] * 2)})
    assert (found.step, found.reached, found.by) == (300, False, ())


@pytest.mark.parametrize("n", [1, 3, 5, 10, 15, 35, 45])
def test_the_share_is_met_exactly(n):
    """Exactly the smallest whole number of seeds of at least 80 % is enough, and one fewer is not."""
    enough = -(-8 * n // 10)
    for count, reached in ((enough, True), (enough - 1, False)):
        scores = np.zeros((n, 3))
        scores[:count, 0] = 1.0
        assert common_step(STEPS, {"pebble": scores}).reached is reached


def test_almost_full_success_is_not_full():
    """99 % does not count as 100 %."""
    assert not common_step([1], {"pebble": np.full((5, 1), 0.99)}).reached


def test_methods_that_arrive_together_are_both_named():
    """The step names every method that got there first."""
    both = {"pebble": np.ones((3, 3)), "rrm-proxy": np.ones((2, 3))}
    assert common_step(STEPS, both).by == ("pebble", "rrm-proxy")


def test_each_replicate_is_read_at_the_step_that_its_own_draws_choose():
    """As drawing the runs one by one and asking `common_step` would have it; of a method that chooses nothing, too."""
    rng = np.random.default_rng(1)
    success = {name: rng.choice([0.5, 1.0], size=(size, 3), p=[0.4, 0.6]) for name, size in (("a", 5), ("b", 4))}
    values = {"a": rng.random((5, 3)), "oracle": rng.random((3, 3))}
    read = read_at_common_step(success, values, rng=np.random.default_rng(2), replicates=200)
    again, picks = np.random.default_rng(2), {}
    for name, size in (("a", 5), ("b", 4), ("oracle", 3)):
        picks[name] = again.integers(size, size=(200, size), dtype=np.int32)
    steps = set()
    for at in range(200):
        step = common_step(STEPS, {name: scores[picks[name][at]] for name, scores in success.items()}).index
        steps.add(step)
        for name, own in values.items():
            np.testing.assert_array_equal(read[name][at], own[picks[name][at], step])
    assert steps == {0, 1, 2}
    last = read_at_common_step({}, values, rng=np.random.default_rng(2), replicates=5)  # of returns
    assert set(last["a"].ravel()) <= set(values["a"][:, -1])


@pytest.mark.parametrize(
    ("steps", "scores", "message"),
    [
        ([], np.ones((3, 0)), "at least one"),
        ([2, 1, 3], np.ones((3, 3)), "increase"),
        (STEPS, np.ones((3, 2)), "belong together"),
        (STEPS, np.full((3, 3), 100.0), "fraction"),
        (STEPS, np.full((3, 3), np.nan), "not finite"),
    ],
)
def test_curves_that_make_no_sense_are_refused(steps, scores, message):
    """Unordered steps, other shapes, percent instead of fractions and NaN raise."""
    with pytest.raises(ValueError, match=message):
        common_step(steps, {"pebble": scores})


def test_areas_that_make_no_sense_are_refused():
    """Steps and values of different length, and NaN, raise."""
    with pytest.raises(ValueError, match="belong together"):
        area_under_curve(STEPS, [1, 2])
    with pytest.raises(ValueError, match="not finite"):
        area_under_curve(STEPS, [1, np.nan, 2])
