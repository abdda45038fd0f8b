"""Random streams."""

import numpy as np
import pytest

from rrm.seeding import Streams, evaluation_seed


def test_streams_do_not_shift_each_other():
    """One more draw from one stream leaves every other as it was."""
    quiet, busy = Streams(3), Streams(3)
    busy.numpy("teacher").random(1000)
    assert quiet.numpy("query").random() == busy.numpy("query").random()


def test_streams_differ_by_name_and_seed():
    """Two names, or two seeds, give other numbers."""
    draws = {Streams(s).numpy(n).random() for s in (0, 1) for n in ("env", "query")}
    assert len(draws) == 4


def test_restored_streams_continue():
    """Saved streams go on with the numbers they would have given."""
    streams = Streams(7)
    streams.numpy("env").random(5)
    saved = streams.state_dict()
    wanted = streams.numpy("env").random(3)
    other = Streams(7)
    other.load_state_dict(saved)
    np.testing.assert_array_equal(wanted, other.numpy("env").random(3))


def test_negative_seed_is_refused():
    """A seed below zero is an error with the range."""
    with pytest.raises(ValueError, match="from 0 up"):
        Streams(-1)


def test_evaluation_seeds_are_distinct_and_fixed():
    """Every (seed, step, episode) has its own evaluation seed, the same at every call."""
    keys = [(s, t, e) for s in range(3) for t in (0, 1000, 2000) for e in range(10)]
    assert len({evaluation_seed(*k) for k in keys}) == len(keys)
    assert evaluation_seed(1, 2, 3) == evaluation_seed(1, 2, 3)
