"""Which pairs are asked about."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rrm.buffers.experience import Episode
from rrm.config import FeedbackConfig
from rrm.queries import _kcenter, disagreement, mean_entropy, member_probabilities, select, uniform_pairs
from tests.rrm.buffers.test_experience import lived


def test_every_start_is_drawn_the_last_one_included():
    """Starts are uniform over all that fit, and never cross into another episode."""
    rng = np.random.default_rng(0)
    rows, counts = np.unique(uniform_pairs([Episode(0, 5), Episode(6, 5)], 3, 30_000, rng), return_counts=True)
    assert rows.tolist() == [0, 1, 2, 6, 7, 8]
    assert abs(counts / 10_000 - 1).max() < 0.05


def test_episodes_shorter_than_a_segment_are_passed_over():
    """Only episodes that hold a segment are drawn from; none at all is an error."""
    rng = np.random.default_rng(0)
    assert set(uniform_pairs([Episode(0, 2), Episode(3, 3)], 3, 50, rng).flat) == {3}
    with pytest.raises(ValueError, match="none of 1 episodes"):
        uniform_pairs([Episode(0, 2)], 3, 1, rng)


@given(
    st.integers(1, 60), st.integers(0, 300), st.integers(1, 300), st.integers(0, 999),
    st.sampled_from(["constant", "decay", "grow"]),
)  # fmt: skip
def test_the_budget_is_never_exceeded(batch, requested, budget, step, schedule):
    """Whatever the schedule, no session asks for more than is left."""
    config = FeedbackConfig(batch=batch, budget=budget, schedule=schedule)
    count = config.session_size(step, 1000, requested)
    assert 0 <= count <= max(0, budget - requested)


def test_schedules_follow_their_formulas():
    """Constant, falling and growing batches at half time (B-Pref)."""
    sizes = {s: FeedbackConfig(batch=50, schedule=s).session_size(500, 1000, 0) for s in ("constant", "decay", "grow")}
    assert sizes == {"constant": 50, "decay": 25, "grow": 99}


def test_scores_by_hand():
    """Deviation and entropy of three members' probabilities."""
    p = np.array([[0.5, 1.0], [0.5, 0.0], [0.5, 0.5]], np.float32)
    np.testing.assert_allclose([0.0, 0.5], disagreement(p), atol=1e-6)
    np.testing.assert_allclose([np.log(2), np.log(2) / 3], mean_entropy(p), atol=1e-5)


def test_kcenter_is_greedy_farthest_first():
    """Each pick is the farthest from all centres and picks so far, as brute force finds it."""
    rng = np.random.default_rng(1)
    points, centers = rng.normal(size=(12, 3)).astype(np.float32), rng.normal(size=(2, 3)).astype(np.float32)
    taken = [*centers]
    for pick in _kcenter(points, centers, 5):
        gaps = [min(np.linalg.norm(p - t) for t in taken) for p in points]
        assert pick == int(np.argmax(gaps))
        taken.append(points[pick])


class Opinions:
    """A reward whose members disagree about late steps only."""

    def members(self, segments):
        late = segments.obs[..., 1] / 100
        return torch.stack([late, -late, 0 * late])


@pytest.mark.parametrize("sampler", ["disagreement", "entropy", "kcenter", "kcenter-disagreement", "kcenter-entropy"])
def test_every_sampler_returns_pairs_of_its_pool(sampler):
    """As many pairs as asked, of rows that exist."""
    config = FeedbackConfig(sampler=sampler, pool=5)
    pairs = select(
        config, 4, segment=3, experience=lived([9, 9]), reward=Opinions(), labelled=np.zeros((0, 2), np.int64),
        rng=np.random.default_rng(0), first=False,
    )  # fmt: skip
    allowed = {*range(7), *range(10, 17)}
    assert pairs.shape == (4, 2)
    assert set(pairs.flat) <= allowed


def asked_and_pool(sampler, count=3, labelled=None):
    """What a sampler picks, and the pool it picked from."""
    experience = lived([30])
    config = FeedbackConfig(sampler=sampler, pool=20)
    pool = uniform_pairs(experience.episodes, 2, 20 * count, np.random.default_rng(0))
    labelled = pool[:0] if labelled is None else labelled
    pairs = select(
        config, count, segment=2, experience=experience, reward=Opinions(), labelled=labelled,
        rng=np.random.default_rng(0), first=False,
    )  # fmt: skip
    return pairs, pool, member_probabilities(experience, Opinions(), pool, 2)


@pytest.mark.parametrize(("sampler", "score"), [("disagreement", disagreement), ("entropy", mean_entropy)])
def test_the_highest_scores_of_the_pool_are_asked(sampler, score):
    """The pairs chosen are those of the pool that score highest, whatever their order."""
    pairs, pool, probability = asked_and_pool(sampler)
    best = pool[np.argsort(-score(probability), kind="stable")[:3]]
    assert sorted(map(tuple, best)) == sorted(map(tuple, pairs))


@pytest.mark.parametrize(
    ("sampler", "score"), [("kcenter-disagreement", disagreement), ("kcenter-entropy", mean_entropy)]
)
def test_k_center_picks_from_the_better_half(sampler, score):
    """With a score, the farthest are looked for among the half of the pool that scores higher."""
    pairs, pool, probability = asked_and_pool(sampler)
    half = pool[np.argsort(-score(probability), kind="stable")[: len(pool) // 2]]
    assert set(map(tuple, pairs)) <= set(map(tuple, half))


def test_k_center_keeps_away_from_what_was_labelled():
    """The first pick is the pair of the pool farthest from every labelled one."""
    labelled = np.array([[0, 0], [28, 28]])
    pairs, pool, _ = asked_and_pool("kcenter", labelled=labelled)
    nearest = np.sqrt(2) * np.linalg.norm(pool[:, None] - labelled[None], axis=-1).min(axis=1)
    distance = nearest[[int(np.flatnonzero((pool == pairs[0]).all(axis=1))[0])]]
    assert distance == pytest.approx(nearest.max())


def test_the_first_session_is_uniform():
    """Before anything is learned the pool is not scored."""
    never = SimpleNamespace(members=None)
    args = {"experience": lived([9]), "reward": never, "labelled": np.zeros((0, 2), np.int64)}
    rng = np.random.default_rng
    pairs = select(FeedbackConfig(), 4, segment=3, rng=rng(0), first=True, **args)
    np.testing.assert_array_equal(uniform_pairs([Episode(0, 9)], 3, 4, rng(0)), pairs)


def test_only_the_newest_episodes_are_asked_about():
    """The window counts episodes."""
    config = FeedbackConfig(window=1, sampler="uniform")
    pairs = select(
        config, 50, segment=2, experience=lived([5, 5]), reward=Opinions(), labelled=np.zeros((0, 2), np.int64),
        rng=np.random.default_rng(0), first=False,
    )  # fmt: skip
    assert set(itertools.chain.from_iterable(pairs.tolist())) == {6, 7, 8, 9}
