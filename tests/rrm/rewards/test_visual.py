"""Rewards on what a camera shows: an encoder of the agent's that stands still, and an ensemble on its features."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from rrm.buffers.experience import Experience
from rrm.config import DrqConfig, RewardConfig
from rrm.envs import FrameSpace, Spaces
from rrm.nets.encoder import Encoder
from rrm.rewards.sight import Sight
from rrm.rewards.visual import VisualResidual, VisualReward
from rrm.types import Segments, Transition

SPACE = FrameSpace(16, 16, stack=2)
AGENT = DrqConfig(kind="drqv2", channels=4, strides=(2, 1), features=6)
SMALL = RewardConfig(hidden=16, layers=2)
R = AGENT.encoded(16, 16)


def encoder(seed=0):
    return Encoder(AGENT, SPACE, torch.Generator().manual_seed(seed))


def reward(kind, **changes):
    return kind(SMALL.model_copy(update=changes), R, 2, torch.Generator().manual_seed(1), width=AGENT.features)


def filmed(steps=40, horizon=10):
    """Episodes of noise."""
    rng = np.random.default_rng(0)
    experience = Experience(steps, horizon, Spaces(3, 2, SPACE), 3)
    pictures = rng.integers(0, 256, (steps + 1, 3, 16, 16), np.uint8)
    for step in range(steps):
        newest, over = (pictures[max(step - 1, 0)], pictures[step], pictures[step + 1]), step % horizon == horizon - 1
        transition = Transition(
            rng.normal(size=3).astype(np.float32), rng.uniform(-1, 1, 2).astype(np.float32),
            rng.normal(size=3).astype(np.float32), rng.normal(), 0.0, rng.normal(), False, over,
            np.stack(newest[:2]), np.stack(newest[1:]),
        )  # fmt: skip
        experience.append(transition, 0.0)
    return experience


def segments(*shape, generator=None):
    generator = generator or torch.Generator().manual_seed(2)
    draw = lambda *size: torch.randn(*shape, *size, generator=generator)  # noqa: E731
    return Segments(draw(R), draw(2), draw())


def test_the_encoder_makes_as_many_numbers_as_the_configuration_says():
    assert encoder().outputs == R
    assert DrqConfig(kind="drqv2").encoded(64, 64) == 20_000  # appendix, "Model structure"
    assert DrqConfig(kind="drqv2").encoded(84, 84) == 39_200


@pytest.mark.parametrize("kind", [VisualReward, VisualResidual])
def test_members_with_and_without_gradient(kind):
    """Both ways through the networks say the same, of inputs that the members share and of inputs of their own."""
    model, shared = reward(kind), segments(5, 4)
    own = Segments(*(field.expand(3, *field.shape).contiguous() for field in shared))
    with_gradient = model.members(shared)
    with torch.no_grad():
        assert with_gradient.shape == (3, 5, 4)
        torch.testing.assert_close(model.members(shared), with_gradient)
        torch.testing.assert_close(model.members(own), with_gradient)
        flat = Segments(*(field.flatten(0, 1) for field in shared))
        torch.testing.assert_close(model.predict(*flat), with_gradient.mean(0).flatten())
    assert len({tuple(member.flatten().tolist()) for member in with_gradient}) == 3
    with_gradient.sum().backward()
    assert all(float(leaf.grad.abs().sum()) > 0 for leaf in model.parameters())


def test_the_residual_is_bounded_and_sees_the_prior():
    """R = r0 + tanh(f(features, a, r0)); without a prior nothing of r0 is looked at."""
    shared = segments(5, 4)
    moved = shared._replace(prior=shared.prior + 3)
    with torch.no_grad():
        residual, plain = reward(VisualResidual), reward(VisualReward)
        before, after = residual.members(shared) - shared.prior, residual.members(moved) - moved.prior
        assert before.abs().max() < 1
        assert not torch.allclose(before, after)
        assert torch.equal(plain.members(shared), plain.members(moved))
        assert plain.members(shared).abs().max() < 1


@pytest.mark.parametrize("kind", [VisualReward, VisualResidual])
def test_saved_and_loaded(kind):
    model, other, shared = reward(kind), reward(kind, lr=1.0), segments(2, 3)
    with torch.no_grad():
        for leaf in model.parameters():
            leaf.add_(0.1)
        assert not torch.equal(other.members(shared), model.members(shared))
        other.load_state_dict(model.state_dict())
        assert torch.equal(other.members(shared), model.members(shared))


def test_sight_stands_still_until_it_is_renewed():
    """The agent's encoder learns on; what the reward sees of a row changes at sessions alone."""
    experience, mine = filmed(), encoder()
    sight = Sight(experience, mine)
    rows = torch.arange(3, 8)
    before = sight(rows)
    mine.flat.mul_(1.5)
    assert torch.equal(sight(rows), before)
    sight.renew(mine)
    after = sight(rows)
    assert not torch.allclose(after, before)
    exact = mine.encode(experience.stacks(3, 8))
    torch.testing.assert_close(after, exact, rtol=1e-3, atol=1e-3)  # remembered in half precision
    torch.testing.assert_close(sight.one(experience.stacks(5, 6)[0].numpy()), exact[2:3])


def test_sight_without_room_to_remember(monkeypatch):
    """Every segment is looked at anew, in the axes of its rows."""
    experience, mine = filmed(), encoder()
    rows = torch.tensor([[[3, 4], [20, 21]], [[0, 1], [9, 10]]])
    remembered = Sight(experience, mine)(rows)
    monkeypatch.setattr("rrm.rewards.sight._LARGEST", 0)
    looked = Sight(experience, mine)(rows)
    assert looked.shape == (2, 2, 2, R)
    torch.testing.assert_close(looked, remembered, rtol=1e-3, atol=1e-3)


#: Prints MB of features of 4,000 rows in half precision, and by how much the process' largest size has grown for them.
LOOKING = """
import re
from pathlib import Path
import torch
from rrm.nets.encoder import Encoder
from rrm.rewards.sight import Sight
from tests.rrm.rewards.test_visual import AGENT, SPACE, filmed

def peak():
    return int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]) / 1e3

large = AGENT.model_copy(update={"channels": 64, "strides": (1,)})
experience, encoder = filmed(4000, horizon=100), Encoder(large, SPACE, torch.Generator().manual_seed(0))
sight, rows = Sight(experience, encoder), torch.arange(3)
encoder.encode(experience.stacks(0, 256))
before = peak()
sight(rows)
sight.renew(encoder)
sight(rows)
print(experience.rows * encoder.outputs * 2 / 1e6, peak() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="Linux tells a process' largest size")
def test_looking_takes_the_memory_of_what_is_remembered():
    """And little more, however much is looked at in one go, and once again with another encoder."""
    command = [sys.executable, "-c", LOOKING]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], check=True, capture_output=True, text=True)
    features, grown = map(float, done.stdout.split())
    assert features > 100
    assert grown < 1.5 * features


def test_sight_sees_the_same_bits_after_an_interruption():
    experience, mine = filmed(), encoder()
    sight = Sight(filmed(25), mine)
    sight.renew(mine)
    sight(torch.arange(25))
    sight._experience = experience  # the run went on
    again = Sight(experience, encoder(1))
    again.load_state_dict(sight.state_dict())
    rows = torch.arange(experience.rows)
    assert torch.equal(sight(rows), again(rows))


def test_relabelling_keeps_the_prior():
    """Stored rewards are those of the features; r0 is the one of collection, and the true reward is not looked at."""
    experience, model = filmed(), reward(VisualResidual)
    experience.seen = sight = Sight(experience, encoder())
    prior = experience.prior.clone()
    experience.relabel(model.predict)
    rows = experience.since(0)
    assert torch.equal(experience.prior[rows], prior[rows])
    assert (experience.reward[rows] - prior[rows]).abs().max() < 1
    expected = model.predict(sight(torch.arange(experience.rows))[rows], experience.act[rows], prior[rows])
    torch.testing.assert_close(experience.reward[rows], expected)
    shown = experience.segments(torch.tensor([0, 12]), 4)
    assert torch.equal(shown.obs, sight(torch.tensor([[0, 1, 2, 3], [12, 13, 14, 15]])))
