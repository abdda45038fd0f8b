"""SURF: crops, pseudo-labels, and what they teach."""

import math
from itertools import islice

import numpy as np
import pytest
import torch

from rrm.config import RewardConfig, SurfConfig
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.rewards.pebble import Pebble
from rrm.rewards.surf import Surf
from rrm.types import Segments

SURF = SurfConfig(margin=2, crop=2, threshold=0.9)
CONFIG = RewardConfig(learner="surf", hidden=32, layers=2, lr=3e-3, epochs=40, minibatch=16, surf=SURF)
STEPS = 6 + 2 * SURF.margin  # of a segment with its margins


def segments(count, seed, prior=0.0):
    generator = torch.Generator().manual_seed(seed)
    draw = lambda width: torch.randn(count, STEPS, width, generator=generator)  # noqa: E731
    return Segments(draw(3), draw(2), torch.full((count, STEPS), prior))


def middle(field):
    return field[:, SURF.margin : STEPS - SURF.margin]


class Answers:
    """Pairs held as tensors, `labels` of them labelled: the second where the first observation's sum is larger."""

    def __init__(self, labels, unlabelled, prior=0.0):
        self.asked = segments(labels, 1, prior), segments(labels, 2, prior)
        self.others = segments(unlabelled, 3, prior), segments(unlabelled, 4, prior)
        first, second = (middle(s.obs)[..., 0].sum(-1) for s in self.asked)
        self.target = (second > first).float()

    def __len__(self):
        return len(self.target)

    @property
    def unlabelled(self):
        return len(self.others[0].obs)

    def pairs(self, index):
        return *self._taken(self.asked, index), self.target[index]

    def unlabelled_pairs(self, index):
        return self._taken(self.others, index)

    @staticmethod
    def _taken(pairs, index):
        return tuple(Segments(*(field[index] for field in s)) for s in pairs)


def learner(config=CONFIG, kind=EnsembleReward, seed=0):
    return Surf(kind(config, 3, 2, torch.Generator().manual_seed(0)), config, np.random.default_rng(seed))


def changed(config=CONFIG, surf=None, **fields):
    return config.model_copy(update={"surf": SURF.model_copy(update=surf or {}), **fields})


def test_it_asks_for_longer_segments_and_pairs_without_labels():
    """What sessions have to provide follows from the settings."""
    needs = learner(changed(surf={"margin": 3, "unlabelled": 7})).needs
    assert (needs.margin, needs.unlabelled) == (3, 7)


def test_crops_are_of_one_length_and_start_anywhere():
    """Both segments of a pair have one length within `crop` of the middle's; every length and start occurs."""
    starts, ends = learner()._windows(3, 8000, STEPS)
    length = (ends - starts)[..., 0]
    np.testing.assert_array_equal(length[:, :4000], length[:, 4000:])
    assert sorted(set(length.flat)) == [4, 5, 6, 7, 8]
    for each in range(4, 9):
        first, counts = np.unique(starts[..., 0][length == each], return_counts=True)
        assert first.tolist() == list(range(STEPS - each + 1))
        assert abs(counts / counts.mean() - 1).max() < 0.15
    assert (starts[:, :4000, 0] != starts[:, 4000:, 0]).mean() > 0.7
    assert (starts[..., 1] == SURF.margin).all()
    assert (ends[..., 1] == STEPS - SURF.margin).all()


def by_hand(model, answers, windows, config):
    """The loss of one gradient step, pair by pair and member by member."""
    total = torch.zeros(())
    for kind, pairs in (("labelled", answers.asked), ("unlabelled", answers.others)):
        first, second = (model.members(s) for s in pairs)
        starts, ends = windows[kind]
        count = first.shape[1]
        for member in range(len(first)):
            for pair in range(count):
                sums = []
                for rewards, row in ((first, pair), (second, count + pair)):
                    begin, end = starts[member, row, 0], ends[member, row, 0]
                    sums.append(rewards[member, pair, begin:end].sum())
                logit = sums[1] - sums[0]
                opinion = (middle(second[member])[pair].sum() - middle(first[member])[pair].sum()).detach()
                label, weight = (answers.target[pair], 1.0) if kind == "labelled" else (
                    float(opinion > 0),
                    config.surf.weight * float(torch.sigmoid(opinion.abs()) >= config.surf.threshold),
                )  # fmt: skip
                chance = torch.sigmoid(logit)
                total = total - weight * (label * chance.log() + (1 - label) * (1 - chance).log()) / count
    return total


@pytest.mark.parametrize("kind", [EnsembleReward, ResidualReward])
def test_one_step_by_hand(kind, monkeypatch):
    """One gradient step is Adam's on the two losses as the paper writes them, each pair cropped as drawn."""
    config = changed(surf={"threshold": 0.52, "weight": 0.7}, epochs=1, minibatch=5)
    answers, mine = Answers(5, 12, prior=0.4), learner(config, kind)
    fresh = learner(config, kind)
    draw = lambda count: fresh._windows(3, 2 * count, STEPS)  # noqa: E731
    windows = {"labelled": draw(5), "unlabelled": draw(12)}
    order = iter(windows.values())
    monkeypatch.setattr(mine, "_windows", lambda *_: next(order))
    in_order = lambda _rng, members, count, _size: iter([torch.arange(count).expand(members, -1)])  # noqa: E731
    monkeypatch.setattr("rrm.rewards.surf._minibatches", in_order)
    metrics = mine.fit(answers)
    optimizer = torch.optim.Adam(fresh.reward.parameters(), lr=config.lr)
    loss = by_hand(fresh.reward, answers, windows, config)
    loss.backward()
    optimizer.step()
    assert metrics["reward_loss"] == pytest.approx(loss.item(), rel=1e-5)
    assert 0 < mine.metrics()["pseudo_labelled"] < 1
    for a, b in zip(mine.reward.parameters(), fresh.reward.parameters(), strict=True):
        torch.testing.assert_close(a, b, atol=2e-5, rtol=0)


@pytest.mark.parametrize(("labels", "minibatch", "epochs"), [(10, 16, 20), (50, 16, 7), (32, 16, 3)])
def test_it_takes_its_steps_whatever_the_accuracy(labels, minibatch, epochs, monkeypatch):
    """The number of steps is `ceil(epochs * labels / minibatch)`; knowing the labels ends nothing."""
    surf = learner(changed(epochs=epochs, minibatch=minibatch))
    steps, step = [], surf._optimizer.step
    monkeypatch.setattr(surf._optimizer, "step", lambda: (steps.append(1), step()))
    surf.fit(Answers(labels, 40))
    assert len(steps) == math.ceil(epochs * labels / minibatch)


def test_every_round_goes_through_all_pairs():
    """Each member meets every pair once before any comes again, and in an order of its own."""
    from rrm.rewards.surf import _minibatches

    drawn = list(islice(_minibatches(np.random.default_rng(0), 3, 10, 4), 6))
    assert [part.shape[1] for part in drawn] == [4, 4, 2, 4, 4, 2]
    for turn in (drawn[:3], drawn[3:]):
        orders = torch.cat(turn, dim=1)
        assert torch.equal(orders.sort(dim=1).values, torch.arange(10).expand(3, -1))
        assert not torch.equal(orders[0], orders[1])


@pytest.mark.slow
def test_it_learns_the_ranking():
    """With enough labels it tells them as PEBBLE does."""
    surf = learner()
    assert surf.fit(Answers(200, 400))["label_accuracy"] > 0.9


class Correlated(Answers):
    """Labels say what the first feature is worth; in the pairs nobody labelled, the second feature goes with it."""

    def __init__(self, labels, unlabelled):
        super().__init__(labels, unlabelled)
        for s in self.asked:
            s.obs[..., 1] = 0
        for s in self.others:
            s.obs[..., 1] = s.obs[..., 0]


def knows_the_second_feature(trained):
    """Accuracy on pairs that differ in the second feature alone."""
    pairs = segments(500, 8), segments(500, 9)
    for s in pairs:
        s.obs[..., 0] = 0
    logit = [middle(trained.reward.members(s).mean(0)).sum(-1) for s in pairs]
    truth = [middle(s.obs)[..., 1].sum(-1) for s in pairs]
    return float(((logit[1] > logit[0]) == (truth[1] > truth[0])).float().mean())


@pytest.mark.slow
def test_pseudo_labels_teach_what_no_label_says():
    """What only pairs without a label show is learned from them, and is not without their loss or without certainty."""
    answers = Correlated(100, 600)
    taught = {}
    for name, surf in (("surf", {}), ("no weight", {"weight": 0.0}), ("never sure", {"threshold": 1.0})):
        taught[name] = learner(changed(surf=surf))
        taught[name].fit(answers)
    assert taught["surf"].metrics()["pseudo_labelled"] > 0.3
    assert knows_the_second_feature(taught["surf"]) > 0.75
    assert knows_the_second_feature(taught["no weight"]) < 0.6
    assert knows_the_second_feature(taught["never sure"]) < 0.6


def test_without_crops_and_pseudo_labels_it_is_pebble():
    """No margin, no crop, no weight: the gradient of a full minibatch is PEBBLE's."""
    config = changed(
        surf={"margin": 0, "crop": 0, "weight": 0.0}, epochs=1, minibatch=20, target_accuracy=1.0
    )  # fmt: skip
    answers, mine = Answers(20, 30), learner(config)
    pebble = Pebble(learner(config).reward, config, np.random.default_rng(3))
    mine.fit(answers)
    pebble.fit(answers)
    for a, b in zip(mine.reward.parameters(), pebble.reward.parameters(), strict=True):
        torch.testing.assert_close(a, b, atol=2e-5, rtol=0)


@pytest.mark.slow
def test_a_restored_learner_says_what_it_said():
    """Weights, moments and figures are the state; the next session is the same."""
    answers, one, two = Answers(30, 60), learner(), learner(seed=5)
    one.fit(answers)
    two.load_state_dict(one.state_dict())
    assert one.metrics() == two.metrics()
    for each in (one, two):
        each._rng = np.random.default_rng(1)
        each.fit(answers)
    for a, b in zip(one.reward.parameters(), two.reward.parameters(), strict=True):
        assert torch.equal(a, b)
