import numpy as np
import pytest

from rrmctl.reports.report import COVERAGE
from rrmctl.stats import Iqm, iqm, resample


def ten_episodes(chance):
    """Success rates of ten episodes."""
    return lambda rng, n: rng.binomial(10, chance(rng, n)) / 10


SCORES = {
    "normal": lambda rng, n: rng.normal(size=n),
    "uniform": lambda rng, n: rng.random(n),
    "even": ten_episodes(lambda rng, n: rng.beta(2, 2, n)),
    "lopsided": ten_episodes(lambda rng, n: rng.beta(5, 1, n)),
    "two heaps": ten_episodes(lambda rng, n: np.where(rng.random(n) < 0.7, 0.95, 0.2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCORES)
def test_intervals_cover_what_the_notes_say(name):
    """As many of 2,000 intervals hold the true IQM as the notes of every table tell, but for the simulation's error."""
    rng, draw = np.random.default_rng(1), SCORES[name]
    truth = float(iqm(draw(rng, 2_000_000)))
    for n, (fewest, most) in COVERAGE.items():
        sets = np.stack([draw(rng, n) for _ in range(2000)], axis=1)
        draws = resample([sets], Iqm(), rng=np.random.default_rng(0), replicates=1000)
        low, high = np.quantile(draws, [0.025, 0.975], axis=0)
        covered = 100 * ((low <= truth + 1e-9) & (truth - 1e-9 <= high)).mean()
        assert fewest - 2.5 < covered < most + 2.5, n
