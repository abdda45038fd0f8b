"""The discriminator against closed forms, and its written-out gradient against autograd."""

import numpy as np
import pytest
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, one_hot

from rrm.config import ImitationConfig
from rrm.errors import NumericalError
from rrm.imitation.discriminator import Discriminator, joined
from rrm.types import Batch

GAMMA = 0.9
REWARD = np.array([0.0, 1.0, -0.5, 0.3])
#: Where each action leads from each state; every state can be reached from several, so that g is determined.
NEXT = np.array([[1, 2, 3], [2, 0, 1], [3, 1, 0], [0, 3, 2]])
POLICY = np.array([[0.7, 0.2, 0.1], [0.1, 0.6, 0.3], [0.25, 0.25, 0.5], [0.2, 0.7, 0.1]])


def soft_advantage():
    """What the maximum-entropy expert's log pi is for a reward of the state alone: r(s) + gamma V(s') - V(s)."""
    value = np.zeros(4)
    for _ in range(500):
        q = REWARD[:, None] + GAMMA * value[NEXT]
        value = np.log(np.exp(q).sum(axis=1))
    return q - value[:, None]


def drawn(rng, probability, count):
    """Transitions from uniform states by actions of these probabilities; states are one-hot, actions are left out."""
    state = rng.integers(4, size=count)
    action = (rng.random(count)[:, None] > probability[state].cumsum(axis=1)).sum(axis=1)
    obs, following = (one_hot(torch.from_numpy(s), 4).float() for s in (state, NEXT[state, action]))
    blank = torch.zeros(count)
    return Batch(obs, torch.zeros(count, 0), blank, blank, following, blank + 1), (state, action)


def learned(know_the_policy):
    """The reward g of every state, shifted to mean 0, trained against a policy neither uniform nor optimal."""
    rng = np.random.default_rng(0)
    expert_probability = np.exp(soft_advantage())
    config = ImitationConfig(hidden=32, layers=1, lr=3e-3)
    net = Discriminator(config, 4, 0, GAMMA, generator=torch.Generator().manual_seed(0))
    for _ in range(1500):
        expert, (s, a) = drawn(rng, expert_probability, 512)
        policy, (s_policy, a_policy) = drawn(rng, POLICY, 512)
        log_prob = np.log(POLICY[np.concatenate([s, s_policy]), np.concatenate([a, a_policy])])
        net.step(joined(expert, policy), torch.from_numpy(log_prob * know_the_policy).float())
    g = net.g.predict(torch.eye(4), torch.zeros(4, 0)).numpy()
    return g - g.mean()


def test_a_reward_of_the_state_is_recovered_up_to_a_constant():
    """With the expert's and the policy's states alike, the optimum is f = log pi_E: g is the true reward, shifted."""
    np.testing.assert_allclose(np.exp(soft_advantage()).sum(axis=1), 1.0)
    np.testing.assert_allclose(learned(True), REWARD - REWARD.mean(), atol=0.12)


def test_without_the_policys_density_another_reward_is_found():
    """The optimum would be log(pi_E / pi): the term is what makes the reward the expert's own."""
    assert np.abs(learned(False) - (REWARD - REWARD.mean())).max() > 0.3


def batch(generator, count=6, obs_dim=3, act_dim=2):
    obs, following = (torch.randn(count, obs_dim, generator=generator) for _ in range(2))
    act = torch.rand(count, act_dim, generator=generator) * 2 - 1
    continues = (torch.rand(count, generator=generator) > 0.4).float()
    return Batch(obs, act, torch.zeros(count), torch.zeros(count), following, continues)


@pytest.mark.parametrize("head", ["linear", "tanh"])
@pytest.mark.parametrize("pretrain", ["airl", "mse"])
def test_a_step_is_that_of_autograd_and_torchs_adam(head, pretrain):
    """Weights after three steps, and the norm of the gradient in g, as plain differentiable code has them."""
    generator = torch.Generator().manual_seed(1)
    config = ImitationConfig(hidden=8, layers=2, lr=1e-2, head=head, pretrain=pretrain)
    net = Discriminator(config, 3, 2, GAMMA, generator=torch.Generator().manual_seed(0))
    g, h = ([p.detach().clone().requires_grad_() for p in each.parameters()] for each in (net.g.net, net.h))
    adam = torch.optim.Adam([*g, *h], lr=1e-2)
    for _ in range(3):
        expert, policy = batch(generator), batch(generator)
        log_prob = torch.randn(12, generator=generator)
        both = joined(expert, policy)
        label = torch.cat((torch.ones(6), torch.zeros(6)))
        reward = net.g.net.plain(torch.cat((both.obs, both.act), dim=1), g)[0, 0]
        reward = torch.tanh(reward) if head == "tanh" else reward
        value, following = (net.h.plain(obs, h)[0, 0] for obs in (both.obs, both.next_obs))
        f = reward + GAMMA * both.continues * following - value
        loss = (
            binary_cross_entropy_with_logits(f - log_prob, label)
            if pretrain == "airl"
            else (reward - label).square().mean()
        )
        adam.zero_grad()
        loss.backward()
        expected = torch.cat([p.grad.flatten() for p in g]).norm()
        adam.step()
        assert net.step(both, log_prob) == pytest.approx(float(expected), rel=1e-4)
    for ours, theirs in zip((*net.g.net.parameters(), *net.h.parameters()), (*g, *h), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def test_a_termination_ends_the_bootstrap_and_a_time_limit_does_not():
    """The shaped reward is g - h(s) where the task ended, g + gamma h(s') - h(s) elsewhere."""
    net = Discriminator(ImitationConfig(hidden=8), 3, 2, GAMMA, generator=torch.Generator().manual_seed(0))
    steps = batch(torch.Generator().manual_seed(2))
    h, following = net.h(steps.obs)[0, 0], net.h(steps.next_obs)[0, 0]
    g = net.g.predict(steps.obs, steps.act)
    with torch.no_grad():
        for continues, shaping in ((0.0, -h), (1.0, GAMMA * following - h)):
            f = net.f(steps._replace(continues=torch.full((6,), continues)))
            torch.testing.assert_close(f, g + shaping)


def test_a_loss_that_is_not_finite_is_said():
    """An infinite density would otherwise end in weights that are NaN."""
    net = Discriminator(ImitationConfig(hidden=8), 3, 2, GAMMA, generator=torch.Generator().manual_seed(0))
    steps = batch(torch.Generator().manual_seed(2))
    with pytest.raises(NumericalError, match="loss of the discriminator"):
        net.step(joined(steps, steps), torch.full((12,), float("nan")))
