"""Reward functions and PEBBLE's fit."""

import numpy as np
import pytest
import torch

from rrm.config import RewardConfig, SurfConfig
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.rewards.mrn import Mrn
from rrm.rewards.pebble import Pebble
from rrm.rewards.surf import Surf
from rrm.types import Segments

CONFIG = RewardConfig(hidden=32, layers=2, lr=3e-3, epochs=60, minibatch=16)


def reward(kind, config=CONFIG, seed=0):
    return kind(config, 3, 2, torch.Generator().manual_seed(seed))


def steps(batch, length, prior=0.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    draw = lambda width: torch.randn(batch, length, width, generator=generator)  # noqa: E731
    return Segments(draw(3), draw(2), torch.full((batch, length), prior))


class Labels:
    """Labelled pairs held as tensors; the second is preferred where the first observation's sum is larger."""

    def __init__(self, count, *, worth=lambda s: s.obs[..., 0], prior=None, tie_every=0):
        self.first, self.second = steps(count, 5, seed=1), steps(count, 5, seed=2)
        if prior is not None:
            self.first, self.second = (s._replace(prior=prior(s)) for s in (self.first, self.second))
        self.target = (worth(self.second).sum(-1) > worth(self.first).sum(-1)).float()
        if tie_every:
            self.target[::tie_every] = 0.5

    def __len__(self):
        return len(self.target)

    def pairs(self, index):
        take = lambda s: Segments(*(field[index] for field in s))  # noqa: E731
        return take(self.first), take(self.second), self.target[index]

    @property
    def unlabelled(self):
        return len(self)

    def unlabelled_pairs(self, index):
        return self.pairs(index)[:2]


def test_members_are_bounded_and_differ():
    """Every member's reward lies in (-1, 1), and the members are independent networks."""
    values = reward(EnsembleReward).members(steps(4, 6))
    assert values.shape == (3, 4, 6)
    assert values.abs().max() < 1
    assert not torch.allclose(values[0], values[1])


def test_predict_is_the_mean_over_members():
    """One step's reward is the mean of what the members say."""
    model, segments = reward(ResidualReward), steps(1, 7, prior=0.3)
    wanted = model.members(segments).mean(0)[0]
    torch.testing.assert_close(wanted, model.predict(segments.obs[0], segments.act[0], segments.prior[0]))


def test_the_residual_is_added_to_the_prior():
    """The reward stays within 1 of the prior, wherever the prior is."""
    model = reward(ResidualReward)
    for prior in (-4.0, 0.0, 10.0):
        values = model.members(steps(4, 6, prior=prior))
        assert ((values - prior).abs() < 1).all()


GAUSSIAN = CONFIG.model_copy(update={"bound": "gaussian"})


def test_a_gaussian_residual_has_no_bound():
    """It is the network's own output, and can leave the unit interval; without a prior the reward stays in it."""
    bounded, free = reward(ResidualReward), reward(ResidualReward, GAUSSIAN)
    segments = steps(4, 6, prior=0.5)
    residuals = [model.members(segments) - segments.prior for model in (bounded, free)]
    torch.testing.assert_close(residuals[0], torch.tanh(residuals[1]))
    with torch.no_grad():
        for model in (free, plain := reward(EnsembleReward, GAUSSIAN)):
            model.parameters()[-2].mul_(1000)
    assert (free.members(segments) - segments.prior).abs().max() > 2
    assert plain.members(segments).abs().max() <= 1


def test_the_penalty_is_the_mean_square_of_the_residual():
    """Over all steps, times lambda, the members added up; a tanh needs none, nor does a reward without a prior."""
    segments, values = steps(2, 2, prior=1.0), torch.tensor([[[1.0, 2.0], [0.0, 1.0]], [[3.0, 1.0], [1.0, 1.0]]])
    half = GAUSSIAN.model_copy(update={"penalty": 0.5})
    assert reward(ResidualReward, GAUSSIAN).penalty(values, segments).item() == 2 / 4 + 4 / 4
    assert reward(ResidualReward, half).penalty(values, segments).item() == 0.75
    assert reward(ResidualReward).penalty(values, segments).item() == 0
    assert reward(EnsembleReward, GAUSSIAN).penalty(values, segments).item() == 0


@pytest.mark.slow
@pytest.mark.parametrize("learner_class", [Pebble, Surf, Mrn])
def test_every_learner_pays_the_penalty(learner_class):
    """The dearer a residual, the smaller it stays, whoever trains it."""
    size = []
    for penalty in (0.0, 1.0, 100.0):
        config = GAUSSIAN.model_copy(
            update={"penalty": penalty, "surf": SurfConfig(margin=0, crop=0), "target_accuracy": 1.0}
        )
        labels = Labels(100, prior=lambda s: torch.zeros_like(s.obs[..., 0]))
        learner = learner_class(reward(ResidualReward, config), config, np.random.default_rng(0))
        learner.fit(labels)
        size.append(float(learner.reward.members(labels.first).detach().abs().mean()))
    assert size[0] > 3 * size[1] > 9 * size[2]


def test_the_residual_sees_the_prior():
    """With state and action fixed, another prior gives another residual."""
    model, segments = reward(ResidualReward), steps(4, 6, prior=0.2)
    other = segments._replace(prior=torch.full((4, 6), -0.7))
    residuals = [model.members(s) - s.prior for s in (segments, other)]
    assert not torch.allclose(*residuals, atol=1e-3)


@pytest.mark.parametrize("kind", [EnsembleReward, ResidualReward])
def test_observations_are_shown_as_they_first_lay(kind):
    """Standard inputs are less the mean and over the deviation of what was seen at first; what hardly moved is not
    blown up, what comes later moves nothing, and a copy that is loaded sees the same.
    """
    standard, raw = (reward(kind, CONFIG.model_copy(update={"inputs": i})) for i in ("standard", "raw"))
    first = torch.randn(500, 3) * torch.tensor([4.0, 1.0, 1e-4]) + torch.tensor([7.0, -2.0, 0.5])
    standard.begin(first)
    raw.begin(first)
    segments = steps(4, 6, prior=0.3)
    deviation = torch.cat([first.std(0, correction=0)[:2], torch.tensor([0.05])])
    shown = segments._replace(obs=(segments.obs - first.mean(0)) / deviation)
    torch.testing.assert_close(standard.members(segments), raw.members(shown))
    copy = reward(kind, CONFIG.model_copy(update={"inputs": "standard"}), seed=1)
    copy.load_state_dict(standard.state_dict())
    torch.testing.assert_close(copy.members(segments), standard.members(segments), rtol=0, atol=0)


def test_without_a_prior_the_column_is_not_looked_at():
    """A plain ensemble gives the same reward whatever the prior column holds."""
    model, segments = reward(EnsembleReward), steps(4, 6)
    assert torch.equal(model.members(segments), model.members(segments._replace(prior=torch.ones(4, 6))))


def test_members_of_their_own_batches_are_the_members_on_each():
    """[N, B, T] inputs give member i what it would say of batch i."""
    model, parts = reward(ResidualReward), [steps(4, 5, seed=i) for i in range(3)]
    together = model.members(Segments(*(torch.stack(field) for field in zip(*parts, strict=True))))
    for i, part in enumerate(parts):
        torch.testing.assert_close(model.members(part)[i], together[i])


def held_out_accuracy(learner, labels):
    logit = (learner.reward.members(labels.second) - learner.reward.members(labels.first)).sum(-1).mean(0)
    return float(((logit > 0) == (labels.target > 0.5)).float().mean())


@pytest.mark.parametrize("kind", [EnsembleReward, ResidualReward])
def test_it_learns_the_ranking(kind):
    """After a session, segments are ranked as the teacher ranks them, and the fit says how well."""
    labels = Labels(200)
    learner = Pebble(reward(kind), CONFIG, np.random.default_rng(0))
    before = held_out_accuracy(learner, labels)
    metrics = learner.fit(labels)
    assert metrics["label_accuracy"] > 0.97
    assert held_out_accuracy(learner, labels) > max(0.95, before)


def test_a_residual_cancels_an_opposite_prior():
    """Given the negated reward as prior, the sum ends up ranking correctly: it needs the prior among its inputs."""
    opposite = lambda s: -torch.tanh(s.obs[..., 0])  # noqa: E731
    labels = Labels(300, worth=lambda s: torch.tanh(s.obs[..., 0]), prior=opposite)
    learner = Pebble(reward(ResidualReward), CONFIG, np.random.default_rng(0))
    assert held_out_accuracy(learner, labels) < 0.3
    learner.fit(labels)
    assert held_out_accuracy(learner, labels) > 0.9


def test_fitting_stops_once_the_labels_are_learned():
    """The epoch whose accuracy exceeds the target is the last; without a target all epochs run."""
    learner = Pebble(reward(EnsembleReward), CONFIG, np.random.default_rng(0))
    assert learner.fit(Labels(100))["epochs"] < 60
    endless = CONFIG.model_copy(update={"target_accuracy": 1.0, "epochs": 7})
    assert Pebble(reward(EnsembleReward), endless, np.random.default_rng(0)).fit(Labels(100))["epochs"] == 7


@pytest.mark.parametrize("most", [1, 6, 7, 10, 1000])
def test_a_session_takes_so_many_steps_at_the_most(most, monkeypatch):
    """Also in the middle of a pass, whose accuracy is then that of the pairs it came to."""
    config, steps = CONFIG.model_copy(update={"target_accuracy": 1.0, "epochs": 4, "most_steps": most}), []
    learner = Pebble(reward(EnsembleReward), config, np.random.default_rng(0))
    monkeypatch.setattr(learner, "_step", lambda: steps.append(1))
    fitted = learner.fit(Labels(100))  # seven steps a pass
    assert len(steps) == min(most, 28)
    assert fitted["epochs"] == min(-(-most // 7), 4)
    assert 0 <= fitted["label_accuracy"] <= 1
    assert 0.3 < fitted["reward_loss"] / config.members < 2  # about log 2 for each member, untrained


def test_ties_count_in_the_loss_and_not_in_the_accuracy():
    """All pairs equal: no accuracy, and a loss of at least ln 2 a member; some equal: the rest is still learned."""
    labels = Labels(32)
    labels.target[:] = 0.5
    config = CONFIG.model_copy(update={"epochs": 2})
    metrics = Pebble(reward(EnsembleReward), config, np.random.default_rng(0)).fit(labels)
    assert np.isnan(metrics["label_accuracy"])
    assert metrics["reward_loss"] >= 3 * np.log(2) - 1e-4
    mixed = Pebble(reward(EnsembleReward), CONFIG, np.random.default_rng(0)).fit(Labels(200, tie_every=4))
    assert mixed["label_accuracy"] > 0.97


def test_one_step_is_adam_on_the_bradley_terry_loss():
    """Three full batches move the weights as torch's Adam does on the mean cross-entropy of each member, by hand."""
    config = CONFIG.model_copy(update={"epochs": 3, "minibatch": 64, "target_accuracy": 1.0})
    labels = Labels(20)
    learner, plain = Pebble(reward(ResidualReward), config, np.random.default_rng(0)), reward(ResidualReward)
    learner.fit(labels)
    optimizer = torch.optim.Adam(plain.parameters(), lr=config.lr)
    for _ in range(3):
        optimizer.zero_grad()
        sums = torch.stack([plain.members(labels.first).sum(-1), plain.members(labels.second).sum(-1)])
        log_p = torch.log_softmax(sums, dim=0)
        picked = torch.where(labels.target > 0.5, log_p[1], log_p[0])
        (-picked.mean(dim=1).sum()).backward()
        optimizer.step()
    for mine, theirs in zip(learner.reward.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-4, rtol=0)


def test_a_restored_learner_continues_bit_for_bit():
    """Weights and moments are the state; the next session is the same."""
    labels = Labels(50)
    one = Pebble(reward(EnsembleReward), CONFIG, np.random.default_rng(0))
    one.fit(labels)
    two = Pebble(reward(EnsembleReward, seed=9), CONFIG, np.random.default_rng(5))
    two.load_state_dict(one.state_dict())
    for learner in (one, two):
        learner._rng = np.random.default_rng(1)
        learner.fit(labels)
    for a, b in zip(one.reward.parameters(), two.reward.parameters(), strict=True):
        assert torch.equal(a, b)
