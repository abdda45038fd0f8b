"""Discriminator and agent together: what is rewarded, what is kept."""

import numpy as np
import pytest
import torch

from rrm.config import ImitationConfig
from rrm.imitation.discriminator import Discriminator
from rrm.seeding import Streams
from rrm.sources.adversarial import Adversarial
from rrm.types import Batch, Evaluation, Transition
from tests.rrm.imitation.test_demos import demos

CONFIG = ImitationConfig(hidden=8, layers=1, updates=3, minibatch=4, lr=1e-2)


class Replay:
    """Transitions at random."""

    def draw(self, count, stream, *, newest):
        return batch(int(torch.randint(1000, (1,), generator=stream)), count)

    def sample(self):
        return batch()

    transitions = 32

    def batch(self, numbers):
        return Batch(*(column[numbers] for column in batch(2) if column is not None))


def make(**changes):
    config, streams = CONFIG.model_copy(update=changes), Streams(0)
    net = Discriminator(config, 15, 2, 0.9, generator=streams.torch("imitation-init"))
    return Adversarial(config, demos(), Replay(), net, streams=streams, about={"task": "toy-car"})


def train(source, policy):
    """One round of gradient steps."""
    source.attend(CONFIG.seed_steps, policy)


def batch(seed=0, count=32):
    generator = torch.Generator().manual_seed(seed)
    obs, following = (torch.randn(count, 15, generator=generator) for _ in range(2))
    act = torch.rand(count, 2, generator=generator) * 2 - 1
    return Batch(obs, act, torch.zeros(count), torch.full((count,), 7.0), following, torch.ones(count))


class Uniform:
    """A policy that is uniform in [-1, 1]^2, and notes what it is asked about."""

    def __init__(self):
        self.asked = []

    def log_prob(self, obs, act):
        self.asked.append((obs, act))
        return torch.full((len(obs),), -2 * np.log(2.0))


def test_the_reward_is_the_discriminators_as_it_is_now():
    """Over its running deviation, whatever reward is stored; after a round of training it is another."""
    source, steps = make(), batch()
    raw = source.discriminator.f(steps)
    torch.testing.assert_close(source.batch(None).reward, raw / raw.std())
    train(source, Uniform())
    assert (source.discriminator.f(steps) != raw).all()
    both = torch.cat((raw, source.discriminator.f(steps)))
    torch.testing.assert_close(source.batch(None).reward, both[32:] / both.std())


def test_looking_changes_nothing():
    """The running deviation is that of what the agent was trained on."""
    source, steps = make(), batch(1)
    source.batch(None)
    before = source.state_dict()["airl"]["scale"]
    step = Transition(*(field[0].numpy() for field in (steps.obs, steps.act, steps.next_obs)), 0, 0, 0, False, False)
    source.reward(step)
    assert source.state_dict()["airl"]["scale"] == before


def test_the_policys_density_is_asked_for_the_experts_actions_too():
    """As many of both, expert first, in every gradient step."""
    source, policy = make(), Uniform()
    train(source, policy)
    assert len(policy.asked) == 3
    obs, act = policy.asked[0]
    assert obs.shape == (8, 15)
    assert act.shape == (8, 2)
    assert set(obs[:4, 0].tolist()) <= {0.0, 1.0, 2.0, 3.0, 4.0}  # demonstrations count their steps
    assert (act[:4] == 0).all()
    assert (act[4:] != 0).all()


def test_no_density_is_all_but_zero():
    """The policy's, mixed with a tenth of uniform actions: an expert is not told by what the policy would never do."""
    source, policy, told = make(), Uniform(), []
    policy.log_prob = lambda obs, act: torch.full((len(obs),), -1000.0)
    step = source.discriminator.step
    source.discriminator.step = lambda *args: told.append(args[1]) or step(*args)
    train(source, policy)
    torch.testing.assert_close(torch.stack(told), torch.full((3, 8), np.log(0.1 / 4)))


def test_demonstrations_are_told_from_the_policy():
    """After some rounds g is higher on what the expert does."""
    source = make(updates=200)
    train(source, Uniform())
    g = source.discriminator.g
    expert = demos()
    high = g.predict(torch.from_numpy(expert.obs), torch.from_numpy(expert.act)).mean()
    assert high > g.predict(batch().obs, batch().act).mean() + 1


@pytest.mark.parametrize(
    ("evaluations", "kept"),
    [
        ([(0.2, 5), (1.0, 1), (1.0, 0)], 30),
        ([(0.2, 5), (1.0, 1), (0.9, 9)], 20),
        ([(float("nan"), 5), (float("nan"), 7), (float("nan"), 6)], 20),
    ],
    ids=["last", "best", "return"],
)
def test_the_latest_of_the_best_evaluations_is_kept(evaluations, kept):
    """By success, or by return where the task knows none; with step, range and demonstrations."""
    source, weights = make(), {}
    for step, (success, true_return) in zip((10, 20, 30), evaluations, strict=True):
        train(source, Uniform())
        weights[step] = source.discriminator.g.net.flat.clone()
        source.evaluated(step, Evaluation(true_return, success))
    prior = source.legacy()["imitation"]
    assert prior["step"] == kept
    assert torch.equal(prior["g"], weights[kept])
    assert prior["demonstrations"]["source"] == "test"
    assert prior["shape"] == {"hidden": 8, "layers": 1, "head": "linear"}
    low, high = prior["range"]["policy"]
    assert low < high


def test_where_g_lies_is_kept_with_it():
    """Mean and deviation over the demonstrations and as many transitions from all of the run."""
    source, expert = make(), demos()
    train(source, Uniform())
    source.evaluated(10, Evaluation(1.0, 1.0))
    g, run = source.discriminator.g, Replay().batch(torch.arange(5) * 32 // 5)
    shown = g.predict(torch.from_numpy(expert.obs), torch.from_numpy(expert.act))
    seen = np.concatenate((shown.numpy(), g.predict(run.obs, run.act).numpy())).astype(np.float64)
    prior = source.legacy()["imitation"]
    assert (prior["mean"], prior["std"]) == pytest.approx((seen.mean(), seen.std(ddof=1)))


def test_no_more_is_looked_at_than_the_discriminator_looks_at():
    """Evenly spread, few at a time, of demonstrations, window and run alike."""
    source, asked = make(window=8), []
    net = source.discriminator
    net.most, net.at_once = 4, 3
    told = net.reward
    net.reward = lambda steps: asked.append(steps.obs[:, 0]) or told(steps)
    source.evaluated(10, Evaluation(1.0, 1.0))
    assert [len(part) for part in asked] == [3, 1] * 3
    shown, newest, run = (torch.cat(asked[i : i + 2]) for i in (0, 2, 4))
    assert shown.tolist() == [0.0, 1.0, 2.0, 3.0]  # of 5, which count their steps
    assert torch.equal(newest, batch(2).obs[[24, 26, 28, 30], 0])
    assert torch.equal(run, batch(2).obs[[0, 8, 16, 24], 0])


def test_the_figures_variant_rewards_g_itself():
    """Trained by mean squared error, there is no shaping and no policy in the reward."""
    source = make(pretrain="mse")
    steps = batch()
    g = source.discriminator.g.predict(steps.obs, steps.act)
    torch.testing.assert_close(source.batch(None).reward, g / g.std())
    h = source.discriminator.h.flat.clone()
    train(source, Uniform())
    assert torch.equal(h, source.discriminator.h.flat)
