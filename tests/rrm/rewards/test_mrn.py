"""MRN: the imaginary step of the critic, its gradient, and what it does to the reward."""

import math

import numpy as np
import pytest
import torch

from rrm.agents.sac import Sac
from rrm.config import MrnConfig, RewardConfig, SacConfig
from rrm.envs import Spaces
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.rewards.mrn import Mrn
from rrm.seeding import Streams
from rrm.types import Batch
from tests.rrm.rewards.test_rewards import Labels

OBS, ACT, PAIRS = 3, 2, 6


def config(**mrn):
    given = {"meta_optimizer": "separate", "every": 10} | mrn
    return RewardConfig(learner="mrn", hidden=16, layers=2, lr=1e-3, epochs=5, minibatch=16, mrn=MrnConfig(**given))


def mrn(settings=None, kind=ResidualReward):
    settings = settings or config()
    return Mrn(kind(settings, OBS, ACT, torch.Generator().manual_seed(0)), settings, np.random.default_rng(0))


def sac(critic_lr=0.1):
    return Sac(SacConfig(hidden=16, layers=2, batch=32, critic_lr=critic_lr), Spaces(OBS, ACT), Streams(0))


def batch(rows=32, seed=0):
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(rows, *shape, generator=generator)  # noqa: E731
    continues = (torch.rand(rows, generator=generator) > 0.2).float()
    return Batch(draw(OBS), draw(ACT).tanh(), draw(), torch.full((rows,), torch.nan), draw(OBS), continues)


class Answers(Labels):
    """Labelled pairs, of which the last few are the newest; their first steps are what the critics are asked about."""

    def __init__(self, count=20, newest=PAIRS, tie_every=0):
        super().__init__(count, prior=lambda s: torch.sin(s.obs[..., 1]), tie_every=tie_every)
        self._newest = newest

    def newest(self):
        return torch.arange(len(self))[-self._newest :]


class InDouble:
    """An agent and the reward of a learner, in float64: the same networks, in autograd alone."""

    def __init__(self, agent, learner):
        self._agent, self.critic_lr = agent, agent.critic_lr
        self._params = [p.detach().double().requires_grad_() for p in agent.critic_parameters()]
        self._net = learner.reward._net
        self.reward = [p.detach().double().requires_grad_() for p in learner.reward.parameters()]
        self._value = None

    def critic_parameters(self):
        return self._params

    def q_values(self, obs, act, params=None):
        return self._agent.q_values(obs.double(), act.double(), self._params if params is None else params)

    def q_target(self, given):
        if self._value is None:  # the same noise every time
            self._value = self._agent.q_target(given._replace(reward=torch.zeros(len(given.obs))))
        return given.reward + self._value.double()

    def parameters(self):
        return self.reward

    def members(self, segments):
        inputs = torch.cat([segments.obs, segments.act, segments.prior.unsqueeze(-1)], dim=-1).double()
        outputs = self._net.plain(inputs.flatten(-3, -2), self.reward)
        return segments.prior + torch.tanh(outputs).view(-1, *segments.prior.shape)


@pytest.mark.slow
def test_the_gradient_is_that_of_finite_differences():
    """In float64 the gradient in the reward's weights, through the critic's step, is what nudging each weight says."""
    learner, agent, answers = mrn(), sac(), Answers(tie_every=3)
    answers.target = answers.target.double()
    double = InDouble(agent, learner)
    learner.reward = double
    loss = learner.outer_loss(batch(), double, answers)
    gradients = torch.autograd.grad(loss, double.reward)
    rng, nudge, compared = np.random.default_rng(0), 1e-5, []
    with torch.no_grad():
        for parameter, gradient in zip(double.reward, gradients, strict=True):
            for place in rng.choice(parameter.numel(), min(parameter.numel(), 6), replace=False):
                index = np.unravel_index(place, parameter.shape)
                before, sides = parameter[index].clone(), []
                for sign in (1, -1):
                    parameter[index] = before + sign * nudge
                    with torch.enable_grad():
                        sides.append(learner.outer_loss(batch(), double, answers).item())
                parameter[index] = before
                compared.append(((sides[0] - sides[1]) / (2 * nudge), gradient[index].item()))
    numeric, exact = np.array(compared).T
    assert np.abs(exact).max() > 1e-4
    np.testing.assert_allclose(exact, numeric, atol=1e-5 * np.abs(exact).max(), rtol=1e-5)


@pytest.mark.parametrize("kind", [EnsembleReward, ResidualReward])
def test_the_gradient_in_float32_is_that_in_float64(kind):
    """What refine follows, through the written-out networks, is the gradient of plain autograd in double precision."""
    learner, agent = mrn(kind=kind), sac()
    mine = torch.autograd.grad(learner.outer_loss(batch(), sac(), Answers()), learner.reward.parameters())
    double = InDouble(agent, learner)
    if kind is EnsembleReward:
        double.members = lambda s: torch.tanh(
            double._net.plain(torch.cat([s.obs, s.act], dim=-1).double().flatten(-3, -2), double.reward)
        ).view(-1, *s.prior.shape)
    learner.reward = double
    theirs = torch.autograd.grad(learner.outer_loss(batch(), double, Answers()), double.reward)
    for a, b in zip(mine, theirs, strict=True):
        torch.testing.assert_close(a.double(), b, rtol=1e-3, atol=1e-3 * float(max(t.abs().max() for t in theirs)))


class LinearAgent:
    """Critics that are linear in the observation, and a soft value of one half."""

    critic_lr = 0.3

    def __init__(self):
        self.theta = torch.tensor([[0.2, -0.1, 0.4], [0.0, 0.3, -0.2]], dtype=torch.float64, requires_grad=True)

    def critic_parameters(self):
        return [self.theta]

    def q_values(self, obs, act, params):
        return params[0] @ obs.double().T

    def q_target(self, given):
        return given.reward.double() + 0.99 * given.continues * 0.5


def test_the_outer_loss_by_hand():
    """Linear critics: the step, the log-odds of the newest pairs' first steps and the cross-entropy, in numpy."""
    learner, agent, answers, given = mrn(config(outer_weight=0.7)), LinearAgent(), Answers(tie_every=5), batch()
    loss = learner.outer_loss(given, agent, answers)
    obs = given.obs.double().numpy()
    reward = learner.reward.predict(given.obs, given.act, given.prior).double().numpy()
    y = reward + 0.99 * given.continues.double().numpy() * 0.5
    expected = 0.0
    for theta in agent.theta.detach().numpy():
        ahead = theta - 0.3 * 2 * ((obs @ theta - y)[:, None] * obs).mean(axis=0)
        for pair in range(20 - PAIRS, 20):
            first, second = (ahead @ s.obs[pair, 0].double().numpy() for s in (answers.first, answers.second))
            p, target = 1 / (1 + math.exp(first - second)), float(answers.target[pair])
            expected -= 0.7 * (target * math.log(p) + (1 - target) * math.log(1 - p)) / PAIRS
    assert loss.item() == pytest.approx(expected, rel=1e-5)


def test_the_target_is_that_of_the_critics_update():
    """Reward plus the discounted soft value by the target critics, as torch's own distributions have it."""
    agent, given = sac(), batch()
    agent.target.flat.mul_(1.3)
    given = given._replace(reward=torch.zeros(32, requires_grad=True))
    noise_of = agent._lookahead.get_state()
    target = agent.q_target(given)
    agent._lookahead.set_state(noise_of)
    noise = torch.randn(ACT, 32, generator=agent._lookahead).T
    mean, raw = agent.actor.plain(given.next_obs)[0].T.chunk(2, dim=-1)
    normal = torch.distributions.Normal(mean, (-5 + 3.5 * (torch.tanh(raw) + 1)).exp())
    squashed = torch.distributions.TransformedDistribution(normal, torch.distributions.TanhTransform(cache_size=1))
    pre_tanh = normal.mean + normal.stddev * noise
    log_prob = squashed.log_prob(squashed.transforms[0](pre_tanh)).sum(-1)
    q = agent.target.plain(torch.cat((given.next_obs, torch.tanh(pre_tanh)), dim=-1)).squeeze(1).amin(dim=0)
    wanted = given.reward + 0.99 * given.continues * (q - 0.1 * log_prob)
    torch.testing.assert_close(target, wanted, rtol=1e-4, atol=1e-4)
    (gradient,) = torch.autograd.grad(target.sum(), given.reward)
    assert torch.equal(gradient, torch.ones(32))


def test_asking_leaves_the_agent_as_it_was():
    """Critics, optimisers and the noise of updates and actions are the same after a step of the reward."""
    agent, streams = sac(), Streams(0)
    agent = Sac(agent.config, Spaces(OBS, ACT), streams)
    before = agent.state_dict(), {n: g.get_state() for n, g in streams._torch.items()}
    assert mrn().refine(batch(), agent, Answers())
    after = agent.state_dict(), {n: g.get_state() for n, g in streams._torch.items()}
    for name, tensor in before[0]["tensors"].items():
        assert torch.equal(tensor, after[0]["tensors"][name]) or name == "figures"
    assert {name for name in before[1] if not torch.equal(before[1][name], after[1][name])} == {"lookahead"}
    assert all(p.grad is None for p in agent.critic_parameters())


def test_refining_teaches_what_the_critic_makes_of_the_reward():
    """Step after step the critics one step ahead tell the newest labels better, from the reward's change alone."""
    settings = config(outer_weight=1.0).model_copy(update={"lr": 1e-2})
    learner, agent, answers = mrn(settings), sac(critic_lr=2.0), Answers()
    agent.target.flat.zero_()  # no noise of the next state's value
    before = learner.outer_loss(batch(), agent, answers).item()
    for _ in range(100):
        assert learner.refine(batch(), agent, answers)
    assert learner.outer_loss(batch(), agent, answers).item() < 0.85 * before
    figures = learner.metrics()
    assert figures["meta_steps"] == 100
    assert figures["meta_gradient"] > 0


def test_shared_momentum_hides_the_gradient():
    """MRN's own Adam still moves along the labels' gradient; one of its own follows the outer loss from the start."""
    cosines = {}
    for name in ("shared", "separate"):
        learner = mrn(config(meta_optimizer=name))
        learner.fit(Answers())
        steps = learner._optimizer.state_dict()["state"][0]["step"].item()
        learner.refine(batch(), sac(critic_lr=1e-4), Answers())
        assert learner._optimizer.state_dict()["state"][0]["step"].item() - steps == (name == "shared")
        cosines[name] = learner.metrics()["meta_cosine"]
    assert abs(cosines["shared"]) < 0.2
    assert cosines["separate"] > 0.4


def test_the_cosine_is_between_descent_and_step():
    """For an optimiser that is gradient descent it is one."""
    learner = mrn()
    learner._meta_optimizer = torch.optim.SGD(learner.reward.parameters(), lr=100.0)
    learner.refine(batch(), sac(), Answers())
    assert learner.metrics()["meta_cosine"] == pytest.approx(1, abs=1e-4)


def test_without_labels_nothing_is_refined():
    """The reward stays as it is, and the loop is told so; fewer labels than a session asks for are enough."""
    learner = mrn()
    before = learner.reward.state_dict()["weights"]
    assert not learner.refine(batch(), sac(), Answers(count=0))
    assert torch.equal(before, learner.reward.state_dict()["weights"])
    assert learner.refine(batch(), sac(), Answers(count=2))
    assert not torch.equal(before, learner.reward.state_dict()["weights"])


def test_its_needs_are_its_settings():
    """How often, only while there are questions left, and whether time limits end an episode."""
    needs = mrn(config(every=7, faithful_done=True)).needs
    assert (needs.refine_every, needs.refine_when_spent, needs.time_limits_end) == (7, False, True)
    assert not mrn().needs.time_limits_end


@pytest.mark.parametrize("optimizer", ["shared", "separate"])
def test_a_restored_learner_goes_on_bit_for_bit(optimizer):
    """Weights, both optimisers' moments and the figures are the state."""
    one, two = mrn(config(meta_optimizer=optimizer)), mrn(config(meta_optimizer=optimizer))
    one.fit(Answers())
    one.refine(batch(), sac(), Answers())
    two.load_state_dict(one.state_dict())
    assert one.metrics() == two.metrics()
    for each in (one, two):
        each._rng = np.random.default_rng(1)
        each.refine(batch(seed=1), sac(), Answers())
        each.fit(Answers())
    assert torch.equal(*(each.reward.state_dict()["weights"] for each in (one, two)))
