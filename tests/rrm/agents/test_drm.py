"""DrM against the textbook's: what it adds to DrQ-v2, each part by itself."""

import math

import pytest
import torch
from torch import nn

from rrm.agents.drm import Drm, dormant_ratio
from rrm.config import DrmConfig
from rrm.nets.tower import Tower
from rrm.seeding import Streams
from tests.rrm.agents import reference_drqv2 as textbooks
from tests.rrm.agents.test_drqv2 import SPACES, follow, windows, with_biases
from tests.rrm.agents.test_sac import assert_same
from tests.rrm.nets.test_encoder import scenes

SMALL = DrmConfig(
    kind="drm", channels=4, strides=(2, 1), hidden=24, features=10, shift=3, batch=20, lr=1e-3, stddev_steps=1000,
    perturb_every=1000, dropout=0.2,
)  # fmt: skip


def make(seed: int = 1, **changes: object) -> Drm:
    return Drm(SMALL.model_copy(update=changes), SPACES, Streams(seed))


@pytest.mark.slow
@pytest.mark.parametrize("target_ratio", [0.0, 1.0])
def test_several_updates(target_ratio: float) -> None:
    """Losses, gradients and parameters follow the textbook's, with units dropped in the critics and in their target,
    normalised layers, and a value of the data's best actions; asleep, and awake.
    """
    streams = Streams(2)
    config = SMALL.model_copy(update={"target_ratio": target_ratio, "perturb_every": 10**6})
    agent = with_biases(Drm(config, SPACES, streams))
    textbook = textbooks.ReferenceDrm(agent, torch.float64, torch.Generator())
    value = agent.value.flat.clone()
    follow(agent, textbook, streams, 4)
    assert agent.figures()["dormant_ratio"] == pytest.approx(textbook.dormant_ratio)
    assert not torch.equal(agent.value.flat, value)
    for ours, theirs in zip(agent.value.parameters()[:4], textbook.net.trunk.parameters(), strict=True):
        torch.testing.assert_close(ours.double(), theirs, rtol=1e-3, atol=1e-4)


def test_dormant_units() -> None:
    """Hidden units are counted behind their ReLU, which leaves some of them nothing; trunk and output as they are."""
    actor = Tower(1, 6, 4, hidden=5, layers=2, outputs=3, generator=None)
    with torch.no_grad():
        weight, _, gain, _, first, first_bias, *_ = actor.parameters()
        weight.copy_(torch.eye(4, 6))
        gain.fill_(1)
        first.fill_(0.1)
        first_bias.copy_(torch.tensor([-9.0, -9.0, 1.0, 1.0, 1.0]))  # two that are never above zero
    features = torch.tensor([[3.0, 2.0, 1.0, 0.01, 9.0, 9.0]]).repeat(4, 1)
    share = dormant_ratio(actor.outputs(features @ weight.detach().t()), 0.025)
    # One of the trunk; two of the first hidden layer; of the others, which are all alike, none.
    assert share.item() == pytest.approx(3 / (4 + 5 + 5 + 3))


def test_dormant_units_as_its_code_counts_them() -> None:
    """Of a whole agent: the official hooks, which see what a ReLU in place wrote over."""
    agent = with_biases(make(hidden=60))
    features = agent.encoder.encode(scenes(30, frames=SPACES.frames))
    pre = features @ agent.actor.trunk.t()
    theirs = textbooks.dormant_ratio(textbooks.TrunkAndHeads(agent.actor), features, 0.3)
    assert dormant_ratio(agent.actor.outputs(pre), 0.3).item() == pytest.approx(theirs)
    assert theirs > 0.1


def test_it_awakens() -> None:
    """Noise follows the dormant units until they are fewer than the target; from then on also a schedule that begins
    there, whichever is more.
    """
    agent = make(stddev=1.0, target_ratio=0.0)  # which no ratio is below
    assert agent.stddev == pytest.approx(1 / (1 + math.exp(-10)))  # all count as dormant before the first update
    agent.at(100)
    agent.update(windows(0))
    asleep = 1 / (1 + math.exp(-10 * agent.dormant_ratio))
    assert agent.stddev == pytest.approx(asleep)
    assert asleep < 1

    agent = make(target_ratio=1.0)
    agent.at(300)
    agent.update(windows(0))
    assert agent.dormant_ratio < 1
    for step, expected in ((300, 1.0), (800, 0.55), (1300, 0.1)):
        agent.at(step)
        assert agent.stddev == pytest.approx(expected, abs=0.01)
    agent._dormant.fill_(1.0)  # falling asleep again: more noise, awake as it is
    assert agent.stddev == pytest.approx(0.5)


def test_a_perturbation() -> None:
    """The first update from each multiple of `perturb_every` on moves linear layers towards fresh ones, those of the
    target to others, and clears every Adam; convolutions and what normalises stay.
    """
    kept = 0.9
    agent = with_biases(make(lr=1e-9, tau=0.0, least_kept=kept))
    agent.at(999)
    agent.update(windows(0))
    agent.target.flat.copy_(agent.critic.flat)
    towers = agent.actor, agent.critic, agent.target, agent.value
    before, encoder = [textbooks.TrunkAndHeads(tower) for tower in towers], agent.encoder.flat.clone()
    agent.at(1001)
    agent.update(windows(1))
    torch.testing.assert_close(agent.encoder.flat, encoder)
    for was, tower in zip(before, towers, strict=True):
        for old, new in zip(was.modules(), textbooks.TrunkAndHeads(tower).modules(), strict=True):
            if isinstance(old, nn.LayerNorm):
                torch.testing.assert_close(new.state_dict(), old.state_dict())
            elif isinstance(old, nn.Linear):
                torch.testing.assert_close(new.bias, kept * old.bias, rtol=1e-4, atol=1e-6)
                drawn = (new.weight - kept * old.weight).detach() / (1 - kept)
                rows = drawn if len(drawn) <= drawn.shape[1] else drawn.t()
                torch.testing.assert_close(rows @ rows.t(), torch.eye(len(rows)), rtol=0, atol=1e-3)
    assert not torch.equal(agent.target.flat, agent.critic.flat)
    assert {name: int(adam["steps"]) for name, adam in agent.state_dict()["optimisers"].items()} == dict.fromkeys(
        ("encoder", "actor", "critic", "value"), 1
    )
    once = agent.actor.flat.clone()
    agent.update(windows(2))
    torch.testing.assert_close(agent.actor.flat, once)  # not again until the next multiple


@pytest.mark.parametrize(("ratio", "kept"), [(0.0, 0.9), (0.3, 0.4), (1.0, 0.2)])
def test_how_much_a_perturbation_keeps(ratio: float, kept: float) -> None:
    """The less, the more units are dormant: one less twice their share, within bounds."""
    agent = make(lr=1e-9)
    bias = agent.actor.parameters()[1]
    bias.data.fill_(1.0)
    agent._dormant.fill_(ratio)
    agent.at(1000)
    agent.update(windows(0))
    torch.testing.assert_close(bias.detach(), torch.full_like(bias, kept))


def test_critics_are_normalised_and_drop_units() -> None:
    """Also the target, which differs from pass to pass; the actor does not."""
    agent = make()
    for critic in (agent.critic, agent.target):
        modules = list(textbooks.TrunkAndHeads(critic).heads[0])
        names = [type(module) for module in modules]
        assert names == [*[nn.Linear, nn.Dropout, nn.LayerNorm, nn.ReLU] * 2, nn.Linear]
        pre, act, noise = torch.randn(8, 10), torch.zeros(8, 2), torch.Generator()
        first, second = (critic.outputs(pre, act, noise=noise)[-1] for _ in range(2))
        assert not torch.equal(first, second)
    same, again = (agent.actor.outputs(pre)[-1] for _ in range(2))
    assert torch.equal(same, again)


def test_dropped_units_are_made_up_for() -> None:
    """The mean of what is left is that of all."""
    tower = Tower(1, 6, 4, hidden=2000, layers=1, outputs=1, generator=torch.Generator().manual_seed(0), dropout=0.25)
    kept = tower._dropped(torch.ones(1, 3, 2000), torch.Generator().manual_seed(0))
    assert kept.unique().tolist() == pytest.approx([0, 4 / 3])
    assert kept.mean() == pytest.approx(1, abs=0.05)


def test_resumes() -> None:
    """With the ratio, the awakening and the perturbations behind it."""
    streams = Streams(3)
    agent = Drm(SMALL, SPACES, streams)
    assert math.isnan(agent.figures()["dormant_ratio"])

    def train(agent: Drm, seeds: range) -> None:
        for seed in seeds:
            agent.at(400 * seed)
            agent.update(windows(seed))

    train(agent, range(4))  # perturbed at 1,200
    saved, drawn = agent.state_dict(), streams.state_dict()
    train(agent, range(4, 7))
    others = Streams(3)
    other = Drm(SMALL, SPACES, others)
    other.load_state_dict(saved)
    others.load_state_dict(drawn)
    train(other, range(4, 7))
    assert_same(agent.state_dict(), other.state_dict())
    assert agent.figures() == other.figures()


def test_reset_critic() -> None:
    """What was learned from the critics goes with them."""
    agent = make()
    agent.update(windows(0))
    before = agent.state_dict()
    agent.reset_critic()
    after = agent.state_dict()
    for name in ("critic", "value"):
        assert not torch.equal(before["tensors"][name], after["tensors"][name])
        assert not any(moment.any() for moment in after["optimisers"][name].values())
    assert torch.equal(after["tensors"]["critic"], after["tensors"]["target"])
    assert torch.equal(before["tensors"]["encoder"], after["tensors"]["encoder"])
