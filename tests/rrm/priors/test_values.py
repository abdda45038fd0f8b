"""The running scale: worked numbers, numpy as the oracle, and what a scale may never do."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrm.moments import RunningMoments
from rrm.priors.values import scaled


def running(normaliser, seen=None):
    """Takes a value in, then scales it."""
    moments = seen or RunningMoments()

    def scale(value):
        moments.add(value)
        return scaled(value, moments, normaliser)

    return scale


VALUES = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50)


def test_scale_by_hand():
    """The standard deviation is 1 until there are two values; it takes the new one in before it divides."""
    scale = running("scale")
    assert scale(6.0) == 6.0
    assert scale(10.0) == pytest.approx(10.0 / np.sqrt(8))  # std of 6 and 10
    assert scale(8.0) == pytest.approx(8.0 / 2)  # std of 6, 10 and 8


def test_small_priors_pass_unchanged():
    """A prior that spreads by less than 1 is not enlarged: distances in metres keep their meaning."""
    scale = running("scale")
    raw = np.random.default_rng(0).uniform(-1.2, 0, 1000).tolist()
    assert [scale(x) for x in raw] == raw


def test_zscore_by_hand():
    """The first value is its own mean; then mean and standard deviation of all so far."""
    zscore = running("zscore")
    assert zscore(6.0) == 0.0
    assert zscore(10.0) == pytest.approx(2 / np.sqrt(8))
    assert zscore(5.0) == pytest.approx(-2 / np.sqrt(7))


def test_zscore_of_a_constant():
    """A constant prior becomes 0, not a division by zero."""
    zscore = running("zscore")
    assert [zscore(3.0) for _ in range(5)] == [0.0] * 5


@given(VALUES)
def test_moments(xs):
    """Mean and sample standard deviation agree with numpy's over everything seen."""
    moments = RunningMoments()
    for x in xs:
        moments.add(x)
    assert moments.mean == pytest.approx(np.mean(xs), abs=1e-9)
    assert moments.std == pytest.approx(np.std(xs, ddof=1) if len(xs) > 1 else 1.0, abs=1e-6)


@given(VALUES)
def test_scale_only_divides(xs):
    """Every value is divided by a number of at least 1, the spread so far: nothing is shifted, enlarged or turned."""
    scale = running("scale")
    for count, x in enumerate(xs, start=1):
        spread = np.std(xs[:count], ddof=1) if count > 1 else 1.0
        assert scale(x) == pytest.approx(x / max(1.0, spread), abs=1e-6)


@pytest.mark.parametrize("name", ["scale", "zscore"])
def test_resume(name):
    """A saved scale is JSON and continues bit for bit."""
    raw = np.random.default_rng(1).normal(3, 7, 200).tolist()
    whole, seen, restored = running(name), RunningMoments(), RunningMoments()
    expected = [whole(x) for x in raw][100:]
    begun = running(name, seen)
    for x in raw[:100]:
        begun(x)
    restored.load_state_dict(json.loads(json.dumps(seen.state_dict())))
    resumed = running(name, restored)
    assert [resumed(x) for x in raw[100:]] == expected
