"""The sequential test beside enumeration, the package `adastop`, and simulations of its errors."""

import json
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest

from rrmctl.stats import Comparison, Design, Standing, outlook, sequential_test
from rrmctl.stats.sequential import boundaries, sequences

ADASTOP = json.loads((Path(__file__).parent / "references" / "adastop.json").read_text())["cases"]

#: Scores of runs, as they come in the study and as they are hard for a test.
SHAPES = {
    "normal": lambda rng, size: rng.normal(size=size),
    "skewed": lambda rng, size: rng.exponential(size=size),
    "saturated": lambda rng, size: rng.binomial(10, 0.97, size) / 10,
    "two-peaked": lambda rng, size: rng.beta(0.3, 0.1, size),
}


def rng(seed=0):
    return np.random.default_rng(seed)


def decisions(comparisons, **design):
    return [each.decision for each in sequential_test(comparisons, Design(**design))]


def statistics(ours, theirs, group, looks):
    """The absolute statistic of every sequence after each look."""
    signs = sequences(group, looks, 10_000, 0)
    groups = [slice(look * group, (look + 1) * group) for look in range(len(ours) // group)]
    return np.abs(np.cumsum([signs[k] @ [*ours[g], *theirs[g]] for k, g in enumerate(groups)], axis=0))


def test_few_groups_of_few_runs_are_enumerated():
    """Two groups of two: all 6 x 6 sequences of splits, each once, the observed one first."""
    one, two = sequences(2, 2, 10_000, 0)
    found = {(tuple(np.flatnonzero(a > 0)), tuple(np.flatnonzero(b > 0))) for a, b in zip(one, two, strict=True)}
    splits = list(combinations(range(4), 2))
    assert found == set(product(splits, splits))
    assert len(one) == 36
    np.testing.assert_array_equal([one[0], two[0]], [[0.5, 0.5, -0.5, -0.5]] * 2)


def test_more_are_drawn_with_the_first_groups_balanced():
    """Four groups of five: every split of the first equally often, each a fair split, the observed one first."""
    signs = sequences(5, 4, 10_000, 0)
    splits, counts = np.unique(signs[0], axis=0, return_counts=True)
    assert (len(splits), set(counts)) == (252, {39})
    for each in signs:
        np.testing.assert_allclose(each.sum(axis=1), 0.0, atol=1e-12)
        np.testing.assert_allclose(each[0], [0.2] * 5 + [-0.2] * 5)
    assert abs((signs[3] > 0).mean(axis=0) - 0.5).max() < 0.03


@pytest.mark.parametrize("case", ADASTOP)
def test_one_comparison_is_adastops(case):
    """Boundaries at each look and the decision are those of the package where it enumerates."""
    ours, theirs = case["ours"], case["theirs"]
    design = Design(group=case["group"], looks=case["looks"], alpha=case["alpha"])
    (verdict,) = sequential_test([Comparison(ours, theirs)], design)
    assert verdict.decision == case["decision"]
    bounds, _ = boundaries(statistics(ours, theirs, design.group, design.looks), design.looks, design.alpha)
    np.testing.assert_allclose(bounds[: len(case["boundaries"])], case["boundaries"], rtol=1e-9)


def test_five_against_five_need_full_separation():
    """One look, 252 splits: only a full separation, 2 in 252, is below 0.9 %; the next best is 4 in 252."""
    apart = Comparison([6, 7, 8, 9, 10], [1, 2, 3, 4, 5])
    almost = Comparison([5, 7, 8, 9, 10], [1, 2, 3, 4, 6])
    assert decisions([apart], looks=1, alpha=0.009) == ["larger"]
    assert decisions([almost], looks=1, alpha=0.009) == ["equal"]
    assert decisions([almost], looks=1, alpha=0.017) == ["larger"]
    assert decisions([Comparison(apart.theirs, apart.ours)], looks=1, alpha=0.009) == ["smaller"]
    assert decisions([apart], looks=1, alpha=0.0079) == ["equal"]


def test_the_level_is_shared_and_handed_on():
    """Two comparisons halve the level; the one that is decided leaves the other the whole of it."""
    apart = Comparison([6, 7, 8, 9, 10], [1, 2, 3, 4, 5])
    almost = Comparison([5, 7, 8, 9, 10], [1, 2, 3, 4, 6])
    alike = Comparison([1, 5, 6, 7, 2], [2, 3, 5, 1, 8])
    assert decisions([apart, almost], looks=1, alpha=0.018) == ["larger", "larger"]
    assert decisions([apart, alike], looks=1, alpha=0.018) == ["larger", "equal"]
    assert decisions([almost, alike], looks=1, alpha=0.018) == ["equal", "equal"]


def test_a_level_that_is_left_late_decides_as_at_the_look_that_crossed():
    """Ahead at the first look, behind by the second, when another's level comes free: still decided as at the first."""
    turning = Comparison(
        [1.00, 1.01, 1.02, 1.03, 1.04, 0.5, 0.9, 0.7, 0.6, 0.8],
        [0.90, 0.91, 0.92, 0.93, 0.94, 0.7, 0.8, 0.9, 0.95, 0.75],
    )
    late = Comparison([5, 7, 8, 9, 10, 16, 17, 18, 19, 20], [1, 2, 3, 4, 6, 1, 2, 3, 4, 5])
    (alone,) = sequential_test([turning], Design())
    beside, other = sequential_test([turning, late], Design())
    assert (alone.decision, alone.looks, alone.difference) == ("larger", 1, pytest.approx(0.1))
    assert (other.decision, other.looks) == ("larger", 2)
    assert (beside.decision, beside.looks, beside.difference) == ("larger", 2, pytest.approx(-0.01))


@pytest.mark.parametrize("level", [0.0, 1.0, 5.0])
def test_saturated_methods_are_never_separated(level):
    """Every seed of both alike, at zero, 100 % or elsewhere: equal after the last look, nothing crashes."""
    both = Comparison(np.full(10, level), np.full(10, level))
    assert decisions([both], looks=2) == ["equal"]
    assert decisions([both], looks=3) == ["open"]


def test_no_seed_beyond_a_full_group_is_looked_at():
    """Until a group is full nothing is decided, and a half group changes nothing."""
    ours, theirs = np.arange(10.0) + 20, np.arange(10.0)
    assert sequential_test([Comparison([], theirs)], Design())[0].looks == 0
    assert decisions([Comparison(ours[:4], theirs[:4])]) == ["open"]
    five = sequential_test([Comparison(ours[:5], theirs[:5])], Design())
    nine = sequential_test([Comparison(ours[:9], theirs[:9])], Design())
    assert five == nine == [Standing("larger", 1, 20.0)]


@pytest.mark.parametrize("seed", range(5))
def test_further_seeds_change_nothing_that_is_decided(seed):
    """Look by look, as `run --until-decided` does, and all at once: the same verdicts, by the same looks."""
    shifts = (0.0, 0.7, 1.5, 3.0)
    runs = [(rng([seed, at]).normal(shift, 1, 20), rng([seed, 9]).normal(0, 1, 20)) for at, shift in enumerate(shifts)]
    whole = sequential_test([Comparison(*each) for each in runs], Design())
    have = np.full(len(runs), 5)
    for _ in range(4):
        verdicts = sequential_test([Comparison(a[:n], b[:n]) for (a, b), n in zip(runs, have, strict=True)], Design())
        have += [5 if each.decision == "open" else 0 for each in verdicts]
    assert verdicts == whole


def test_scale_and_order_of_methods_do_not_matter():
    """Scores in percent or in millions decide alike, and swapping the methods swaps the words."""
    ours, theirs = rng(1).normal(1.2, 1, 20), rng(2).normal(0, 1, 20)
    (one,) = sequential_test([Comparison(ours, theirs)], Design())
    for factor in (1e-9, 100.0, 1e9):
        (other,) = sequential_test([Comparison(factor * ours, factor * theirs)], Design())
        assert (other.decision, other.looks) == (one.decision, one.looks)
    (swapped,) = sequential_test([Comparison(theirs, ours)], Design())
    assert {one.decision, swapped.decision} == {"larger", "smaller"}
    assert one.looks == swapped.looks


def errors(shape, *, comparisons, repetitions):
    """How often any of several equal methods is separated from the one all are compared with."""
    source, wrong = rng([7, comparisons]), 0
    for repetition in range(repetitions):
        design = Design(permutations=1000, seed=repetition)
        against, *others = (SHAPES[shape](source, design.seeds) for _ in range(comparisons + 1))
        wrong += any(each.separated for each in sequential_test([Comparison(o, against) for o in others], design))
    return wrong / repetitions


def at_most(level, repetitions):
    """The level and three Monte-Carlo errors."""
    return level + 3 * np.sqrt(level * (1 - level) / repetitions)


def test_equal_methods_are_rarely_separated():
    """300 simulated studies of four skewed methods against a fifth: at most 5 % separate any, over all looks."""
    assert errors("skewed", comparisons=4, repetitions=300) <= at_most(0.05, 300)


@pytest.mark.slow
@pytest.mark.parametrize("comparisons", [1, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_error_rate_is_controlled(shape, comparisons):
    """2000 studies for each shape of scores, one comparison and four."""
    assert errors(shape, comparisons=comparisons, repetitions=2000) <= at_most(0.05, 2000)


@pytest.mark.slow
def test_the_error_rate_is_controlled_beside_real_differences():
    """Two methods that differ much hand on the level; the two that do not are still separated in 5 % at most."""
    wrong, source = 0, rng(11)
    for repetition in range(2000):
        runs = [source.normal(shift, 1, 20) for shift in (0, 0, 0, 3, 3)]
        design = Design(permutations=1000, seed=repetition)
        found = sequential_test([Comparison(each, runs[0]) for each in runs[1:]], design)
        wrong += found[0].separated or found[1].separated
    assert wrong / 2000 <= at_most(0.05, 2000)


def separated(shift, looks, repetitions=60):
    """Share of simulated studies with this difference that find it, and the seeds they took on average."""
    source, found = rng(3), []
    for _ in range(repetitions):
        design = Design(looks=looks, permutations=1000)
        pair = Comparison(source.normal(shift, 1, design.seeds), source.normal(0, 1, design.seeds))
        found += sequential_test([pair], design)
    return np.mean([each.separated for each in found]), 5 * np.mean([each.looks for each in found])


def test_power_grows_with_the_difference_and_with_the_looks():
    """Larger differences are found more often and sooner; more looks find the same difference more often."""
    (none, _), (some, long), (all_, short) = separated(0.0, 4), separated(1.0, 4), separated(3.0, 4)
    assert none < 0.2 < some < all_ == 1.0
    assert short < 7.5 < long
    assert separated(1.0, 1)[0] < some


def test_the_outlook_follows_the_difference():
    """Half a spread apart: likely never within 20 seeds; clearly apart but for the first look: at the next."""
    design = Design()
    far = Comparison(np.array([0.1, 1.9, 1.7, 2.2, 2.0]), np.array([0.0, 0.2, -0.3, 0.6, 0.15]))
    near = Comparison(np.array([0.1, 0.9, -0.7, 0.2, 0.4]), np.array([0.0, 0.8, -0.9, 0.6, 0.15]))
    found = [outlook(each, sequential_test([each], design)[0], design, rng=rng(), futures=100) for each in (far, near)]
    assert (found[0].more, found[1].more) == (5, None)
    assert found[1].share < 0.3 < 0.9 < found[0].share


def test_the_outlook_counts_from_the_seeds_there_are():
    """Three of a group of five, far apart: two more; with two there is nothing to imagine from."""
    runs = np.array([9.0, 10.0, 11.0]), np.array([0.0, 1.0, 2.0])
    three, two = Comparison(*runs), Comparison(*(each[:2] for each in runs))
    design = Design()
    assert outlook(three, sequential_test([three], design)[0], design, rng=rng(), futures=50).more == 2
    none = outlook(two, sequential_test([two], design)[0], design, rng=rng())
    assert (np.isnan(none.share), none.more) == (True, None)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Design(group=0), "groups of 1 to 8"),
        (lambda: Design(group=9), "groups of 1 to 8"),
        (lambda: Design(looks=0), "at least one look"),
        (lambda: Design(alpha=0.0), "between 0 and 1"),
        (lambda: Design(alpha=1.0), "between 0 and 1"),
        (lambda: sequential_test([Comparison([1.0, float("nan")], [1.0])], Design()), "not finite"),
        (lambda: sequential_test([Comparison(np.ones((5, 2)), [1.0])], Design()), "one score for each seed"),
        (lambda: outlook(Comparison([], []), Standing("equal", 4, 0.0), Design(), rng=rng()), "open"),
    ],
)
def test_what_makes_no_test_is_refused(call, message):
    """Impossible designs, missing scores and outlooks of what is decided raise."""
    with pytest.raises(ValueError, match=message):
        call()
