"""Running moments."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rrm.moments import RunningMoments

numbers = st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=9), min_size=1, max_size=9)


@given(numbers)
def test_batches_give_what_all_numbers_give(batches):
    """Mean and deviation of batches equal numpy's over everything at once."""
    moments = RunningMoments()
    for batch in batches:
        moments.add(float(np.mean(batch)), float(np.var(batch)), len(batch))
    together = np.concatenate(batches)
    wanted = np.std(together, ddof=1) if len(together) > 1 else 1.0
    np.testing.assert_allclose([np.mean(together), wanted], [moments.mean, moments.std], atol=1e-7)
