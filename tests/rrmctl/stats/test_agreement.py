"""Agreement, against textbooks, other implementations and studies whose truth is known."""

import itertools

import numpy as np
import pytest
from scipy.stats import binomtest

from rrmctl.stats.agreement import alpha, apart, binned, expected_width, kappa, share, slope

GAP = np.nan
#: Krippendorff's own example: four observers, twelve units, values 1 to 5.
TEXTBOOK = np.array([
    [1, 2, 3, 3, 2, 1, 4, 1, 2, GAP, GAP, GAP],
    [1, 2, 3, 3, 2, 2, 4, 1, 2, 5, GAP, 3],
    [GAP, 3, 3, 3, 2, 3, 4, 2, 2, 5, 1, GAP],
    [1, 2, 3, 3, 2, 4, 4, 1, 2, 5, 1, GAP],
]).T  # fmt: skip


def rng():
    return np.random.default_rng(0)


def plain(found):
    return tuple(float(number) for number in (found.estimate, found.low, found.high))


def pair_by_pair(ratings):
    """Alpha as it is defined: every ordered pair of ratings of a unit, weighed by one over the others of that unit."""
    units = [[value for value in unit if not np.isnan(value)] for unit in ratings]
    units = [unit for unit in units if len(unit) > 1]
    everything = [value for unit in units for value in unit]
    n = len(everything)
    observed = sum(sum(a != b for a, b in itertools.permutations(unit, 2)) / (len(unit) - 1) for unit in units) / n
    expected = sum(a != b for a, b in itertools.permutations(everything, 2)) / (n * (n - 1))
    return 1 - observed / expected if expected else np.nan


def test_alpha_is_the_textbooks():
    """.743 of eleven units; the twelfth, with one rating, says nothing."""
    found = alpha(TEXTBOOK, rng=rng())
    assert found.n == 11
    assert float(found.estimate) == pytest.approx(0.743, abs=5e-4)
    assert found.low < found.estimate < found.high


@pytest.mark.parametrize("seed", range(60))
def test_alpha_is_that_of_pairs(seed):
    """Tables of any size, with gaps, against the definition gone through pair by pair."""
    draw = np.random.default_rng(seed)
    ratings = draw.integers(draw.integers(1, 4), size=(draw.integers(2, 15), draw.integers(2, 6))).astype(float)
    ratings[draw.random(ratings.shape) < draw.choice([0, 0.2, 0.4])] = GAP
    reference = pair_by_pair(ratings) if (np.sum(~np.isnan(ratings), axis=1) > 1).any() else np.nan
    assert float(alpha(ratings, rng=draw, replicates=1).estimate) == pytest.approx(reference, abs=1e-12, nan_ok=True)


def test_kappa_is_the_textbooks():
    """Twenty and fifteen times alike, five and ten times not: (.7 - .5) / .5."""
    first, second = (np.repeat(values, (20, 5, 10, 15)) for values in ((1, 1, 0, 0), (1, 0, 1, 0)))
    found = kappa(np.append(first, GAP), np.append(second, 1), rng=rng())
    assert found.n == 50
    assert float(found.estimate) == pytest.approx(0.4)
    assert 0.1 < found.low < 0.2 < 0.6 < found.high < 0.7


def test_what_cannot_be_estimated_is_not():
    """Nobody asked, one rating a unit, values that are all alike, too few units for an interval."""
    nothing, alike = np.full((4, 2), GAP), np.ones((5, 2))
    for found in (alpha(nothing, rng=rng()), alpha(alike, rng=rng()), kappa(*alike.T, rng=rng()), slope([], rng=rng())):
        assert np.isnan(plain(found)).all()
    one, low, high = plain(alpha([[1, 1], [0, 0]], rng=rng()))
    assert (one, np.isnan(low), np.isnan(high)) == (1.0, True, True)
    assert np.isnan(plain(share([]))).all()
    assert np.isnan(plain(apart(share([]), share([1])))).all()
    assert np.isnan(plain(slope([[1.0], [2.0], [GAP, GAP]], rng=rng()))).all()


@pytest.mark.parametrize(("hits", "n"), [(0, 5), (5, 5), (3, 10), (190, 400)])
def test_shares_have_wilsons_interval(hits, n):
    """The same as scipy's."""
    reference = binomtest(hits, n).proportion_ci(method="wilson")
    assert plain(share(np.arange(n) < hits)) == pytest.approx((hits / n, reference.low, reference.high), abs=1e-12)


def test_differences_have_newcombes_interval():
    """56 of 70 and 48 of 80, as in his table II."""
    found = apart(share(np.arange(70) < 56), share(np.arange(80) < 48))
    assert plain(found) == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)


def test_slopes_are_within_sittings():
    """Least squares with a level for each sitting, gaps left out: sittings that differ are no change."""
    draw = np.random.default_rng(3)
    sittings = [level + 0.02 * np.arange(n) + draw.normal(0, 0.1, n) for level, n in ((0, 30), (5, 50), (9, 1))]
    sittings[1][7] = GAP
    rows, values = [], []
    for at, sitting in enumerate(sittings):
        for place, value in enumerate(sitting):
            if not np.isnan(value):
                rows.append([place / 100, *(other == at for other in range(3))])
                values.append(value)
    reference = np.linalg.lstsq(np.array(rows, float), np.array(values), rcond=None)[0][0]
    found = slope(sittings, rng=rng())
    assert float(found.estimate) == pytest.approx(reference)
    assert found.low < 2 < found.high


def test_bins_hold_equally_many():
    """Lowest values first; as many bins as there are values where there are few."""
    bins = binned([4, 1, 3, 2, 6, 5], [1, 0, 0, 1, 1, 1], 3)
    assert [(each.middle, float(each.share.estimate), each.share.n) for each in bins] == [
        (1.5, 0.5, 2), (3.5, 0.5, 2), (5.5, 1.0, 2),
    ]  # fmt: skip
    assert [each.share.n for each in binned([1, 2], [1, 0], 8)] == [1, 1]
    assert binned([], [], 8) == []


def covered(study, truth, studies=200):
    """Share of studies whose interval holds the truth."""
    found = [study(np.random.default_rng([7, number])) for number in range(studies)]
    return np.mean([each.low <= truth <= each.high for each in found])


@pytest.mark.parametrize(("shared", "least"), [(20, 0.86), (80, 0.90)])
def test_alphas_interval_holds_the_truth(shared, least):
    """Five people who are right four times in five: 1 - .32 / .5. With few queries it holds it somewhat less often."""

    def study(draw):
        truth, right = draw.random((shared, 1)) < 0.5, draw.random((shared, 5)) < 0.8
        return alpha(truth == right, rng=draw, replicates=400)

    assert least <= covered(study, 0.36) <= 0.99


def test_a_slopes_interval_holds_the_truth():
    """Two sittings of hits that become rarer by twenty points in a hundred."""

    def study(draw):
        return slope(
            [(draw.random(100) < 0.9 - 0.002 * np.arange(100)) * 1.0 for _ in range(2)], rng=draw, replicates=400
        )

    assert 0.90 <= covered(study, -0.2) <= 0.99


def test_alphas_interval_is_as_wide_as_expected():
    """Half as wide with four times the queries; more people help less."""
    few, many = (expected_width(5, shared, 0.8, rng=rng(), studies=100) for shared in (20, 80))
    assert few == pytest.approx(0.41, abs=0.02)
    assert many == pytest.approx(few / 2, abs=0.03)
    assert few / 2 < expected_width(20, 20, 0.8, rng=rng(), studies=100) < few
