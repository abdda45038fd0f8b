"""The scripted teacher against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrm.buffers.pairs import EQUAL, FIRST, SECOND, SKIPPED
from rrm.config import TeacherConfig
from rrm.teachers import TEACHERS
from rrm.teachers.scripted import ScriptedTeacher, preference_probability, recency_weighted


def told(starts, length):
    """Rewards of the rows: each is worth its own number."""
    return (starts[..., None] + np.arange(length)).astype(np.float32)


def teacher(**config):
    return ScriptedTeacher(TeacherConfig(**config), np.random.default_rng(0), told)


def pairs(first, second, times=1):
    """The same pair of single-step segments, `times` times."""
    return tuple(np.full((times, 1), value, np.float32) for value in (first, second))


def test_the_oracle_prefers_the_larger_sum():
    """Without doubt the larger true sum wins; a tie is the first's."""
    first = np.array([[1, 1], [0, 3], [2, 2]], np.float32)
    second = np.array([[3, 0], [1, 1], [2, 2]], np.float32)
    assert teacher().prefer(first, second).tolist() == [SECOND, FIRST, FIRST]


@pytest.mark.parametrize("difference", [-2.0, -0.5, 0.0, 1.0])
def test_a_stochastic_teacher_answers_with_the_bradley_terry_frequency(difference):
    """At rationality beta the second wins with probability 1 / (1 + exp(-beta d)), within sampling error."""
    labels = teacher(beta=1.5).prefer(*pairs(0.0, difference, 20_000))
    assert labels.mean() == pytest.approx(1 / (1 + np.exp(-1.5 * difference)), abs=0.015)


def test_probabilities_do_not_overflow():
    """Differences of any size give a probability, without a warning."""
    np.testing.assert_array_equal([0.0, 0.5, 1.0], preference_probability(np.array([-1e4, 0.0, 1e4]), 1.0))


@pytest.mark.parametrize("rate", [0.1, 0.15])
def test_mistakes_happen_at_their_rate(rate):
    """A teacher that errs flips labels with the stated probability, whatever the difference."""
    labels = teacher(mistake=rate).prefer(*pairs(0.0, 1000.0, 20_000))
    assert (labels == FIRST).mean() == pytest.approx(rate, abs=0.01)


def test_thresholds_are_shares_of_a_typical_segment():
    """Skip and equal compare with what a segment of recent episodes is worth, not with its square."""
    for kind, low, high in (("equal", 0.9, 1.1), ("skip", 0.9, 1.1)):
        teach = teacher(**{kind: 0.1})
        for _ in range(30):
            teach.observe_return(1000.0, 100)  # 10 a step: a one-step segment is worth 10, a tenth of it 1
        special = EQUAL if kind == "equal" else SKIPPED
        assert teach.prefer(*pairs(0.0, low)).tolist() == pytest.approx([special], nan_ok=True)
        assert teach.prefer(*pairs(0.0, high)).tolist() == [SECOND]


def test_nothing_is_skipped_where_returns_are_negative():
    """A typical segment worth less than nothing gives no threshold below which to skip."""
    teach = teacher(skip=0.5)
    teach.observe_return(-1000.0, 100)
    assert teach.prefer(*pairs(-20.0, -30.0)).tolist() == [FIRST]


def test_only_the_last_ten_episodes_count():
    """The window forgets, and holds nothing before the first episode."""
    teach = teacher(equal=0.1)
    assert teach.prefer(*pairs(0.0, 0.001)).tolist() == [SECOND]
    teach.observe_return(1e9, 1)
    for _ in range(10):
        teach.observe_return(0.0, 1)
    assert teach.prefer(*pairs(0.0, 0.001)).tolist() == [SECOND]


def test_equal_overrides_a_mistake_and_skip_everything():
    """In B-Pref's order: skip, then equal, then the flip."""
    teach = teacher(mistake=1.0, equal=1.0)
    teach.observe_return(10.0, 1)
    assert teach.prefer(*pairs(0.0, 5.0)).tolist() == [EQUAL]
    teach = teacher(mistake=1.0, equal=1.0, skip=1.0)
    teach.observe_return(10.0, 1)
    assert teach.prefer(*pairs(0.0, 5.0)).tolist() == pytest.approx([SKIPPED], nan_ok=True)


@given(st.floats(0.1, 1.0), st.lists(st.floats(-5, 5), min_size=1, max_size=8))
def test_recency_weights_the_last_step_fully(gamma, rewards):
    """The weighted sum equals the loop that discounts towards the past."""
    value = 0.0
    for reward in rewards:
        value = gamma * value + reward
    assert recency_weighted(np.array([rewards]), gamma)[0] == pytest.approx(value, abs=1e-6)


def test_a_restored_teacher_has_the_same_thresholds():
    """The window is part of the state."""
    one, two = teacher(equal=0.5), teacher(equal=0.5)
    one.observe_return(10.0, 1)
    two.load_state_dict(one.state_dict())
    assert one.prefer(*pairs(0.0, 4.0)).tolist() == two.prefer(*pairs(0.0, 4.0)).tolist() == [EQUAL]


def test_every_preset_is_a_configuration():
    """The named teachers are valid, and the paper's are among them."""
    assert {"oracle", "stochastic", "mistaken-10", "mistaken-15"} <= set(TEACHERS)
    for fields in TEACHERS.values():
        TeacherConfig(**fields)
