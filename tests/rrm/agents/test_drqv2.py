"""DrQ-v2 against the textbook's, its state, and what it promises to the training loop."""

import math
import subprocess
import sys
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from rrm.agents.drqv2 import Drq
from rrm.config import DrqConfig
from rrm.envs import FrameSpace, Spaces
from rrm.errors import CheckpointError, NumericalError
from rrm.nets.encoder import Encoder
from rrm.nets.precision import multiplies
from rrm.nets.tower import Tower
from rrm.seeding import Streams
from rrm.types import Batch, Obs
from tests.rrm.agents.reference_drqv2 import Convolutions, ReferenceDrq, TrunkAndHeads
from tests.rrm.agents.test_sac import assert_same
from tests.rrm.nets.test_encoder import scenes

ROWS, ACT = 20, 2
FRAMES = FrameSpace(height=16, width=16)
SPACES = Spaces(5, ACT, FRAMES)
SMALL = DrqConfig(
    kind="drqv2", channels=4, strides=(2, 1), hidden=24, features=10, shift=3, batch=ROWS, lr=1e-3, stddev_steps=1000
)


def windows(seed: int, rows: int = ROWS, steps: int = SMALL.n_step) -> Batch:
    """As a replay has them; some end within or at the end of a window."""
    g = torch.Generator().manual_seed(seed)
    continues = (torch.rand(rows, steps, generator=g) > 0.2).float()
    return Batch(
        obs=torch.zeros(rows, steps, 5), next_obs=torch.zeros(rows, steps, 5), prior=torch.zeros(rows, steps),
        act=torch.rand(rows, steps, ACT, generator=g) * 2 - 1, reward=torch.randn(rows, steps, generator=g),
        continues=continues, frames=scenes(rows, seed, FrameSpace(16, 16, stack=FRAMES.stack + steps)),
    )  # fmt: skip


A = TypeVar("A", bound=Drq)


def with_biases(agent: A) -> A:
    """None of which is zero, as after some training."""
    g = torch.Generator().manual_seed(0)
    for net in (net for net in vars(agent).values() if isinstance(net, Encoder | Tower)):
        for param in net.parameters():
            param.data.add_(torch.empty_like(param).normal_(0, 0.05, generator=g))
    return agent


def draws(streams: Streams, rows: int = ROWS) -> tuple[np.ndarray, Tensor, Tensor]:
    """The moves and noises of the next update, from streams that are copied: nothing is taken."""
    copy = Streams(0)
    copy.load_state_dict(streams.state_dict())
    reach = SMALL.shift
    noise = torch.empty(2, rows, ACT).normal_(generator=copy.torch("agent"))
    return copy.numpy("shift").integers(-reach, reach + 1, (2, rows, 2)), *noise


def flat(module: nn.Module, net: Encoder | Tower, *, grads: bool = False) -> Tensor:
    """The textbook's parameters or gradients, as the network's flat buffer has them."""
    twin = torch.zeros_like(net.flat, dtype=torch.float64)
    start, base = net.flat.data_ptr(), twin
    for place, value in zip(net.parameters(), in_order(module, net, grads=grads), strict=True):
        at = (place.data_ptr() - start) // 4
        base[at : at + place.numel()] = value.flatten()
    return twin


def in_order(module: nn.Module, net: Encoder | Tower, *, grads: bool) -> list[Tensor]:
    def of(params: list[nn.Parameter]) -> list[Tensor]:
        return [(p.grad if grads else p).detach().double() for p in params]  # type: ignore[union-attr]

    if isinstance(module, Convolutions):
        return [p.permute(0, 2, 3, 1) if p.ndim == 4 else p for p in of(list(module.parameters()))]
    assert isinstance(module, TrunkAndHeads)
    heads = zip(*(of(list(head.parameters())) for head in module.heads), strict=True)
    return of(list(module.trunk.parameters())) + [torch.stack(each) for each in heads]


PAIRS = ("encoder", "actor", "critic")


def follow(agent: Drq, textbook: ReferenceDrq, streams: Streams, updates: int) -> None:
    """Losses, gradients and parameters of both, over some updates; every one at another step."""
    lr = agent.config.lr
    for update in range(updates):
        agent.at(400 * update)
        textbook.step = 400 * update
        batch, (moves, noise, noise_next) = windows(update), draws(streams)
        if textbook.noise is not None:  # behind the noise of actions come the units that are dropped
            textbook.noise.set_state(streams.torch("agent").get_state())
            torch.empty(2, ROWS, ACT).normal_(generator=textbook.noise)
        expected = textbook.update(batch, torch.from_numpy(moves), noise.double(), noise_next.double())
        agent.update(batch)
        figures = agent.figures()
        assert {name: figures[name] for name in expected} == pytest.approx(expected, rel=1e-4 if update else 1e-5)
        for name in PAIRS:
            ours, theirs = getattr(agent, name), flat(getattr(textbook, name), getattr(agent, name), grads=True)
            near = 1e-5 if update == 0 and name != "actor" else 5e-3  # the actor's comes after the critics' Adam
            assert (ours.flat_grad - theirs).norm() <= near * theirs.norm(), (update, name)
    for name in (*PAIRS, "target"):
        ours, theirs = getattr(agent, name).flat, flat(getattr(textbook, name), getattr(agent, name))
        apart = (ours - theirs).abs()
        # Adam makes a whole step of a gradient that is nothing but rounding: a few weights may be so far apart.
        assert (apart > 1e-5 + 1e-3 * theirs.abs()).sum() <= 2 + len(apart) // 500, name
        assert apart.max() <= 2 * updates * lr


def test_one_update() -> None:
    """Losses and gradients are those of the published equations in double precision, with the same noise and moves."""
    streams = Streams(1)
    agent = with_biases(Drq(SMALL, SPACES, streams))
    agent.actor.parameters()[-1].data.add_(1.0)  # noise leads beyond the bounds, where actions have a gradient still
    follow(agent, ReferenceDrq(agent, torch.float64), streams, 1)


def test_several_updates() -> None:
    """So are they over several updates, while the noise fades; the target follows."""
    streams = Streams(2)
    agent = with_biases(Drq(SMALL, SPACES, streams))
    follow(agent, ReferenceDrq(agent, torch.float64), streams, 5)


@pytest.mark.skipif(not multiplies("bfloat16"), reason="this processor has no products in bfloat16")
def test_bfloat16() -> None:
    """In bfloat16 an update has the gradients and losses of float32 but for its rounding."""
    exact, rounded = (with_biases(Drq(SMALL, SPACES, Streams(1), precision=p)) for p in ("float32", "bfloat16"))
    for agent in (exact, rounded):
        agent.update(windows(0))
    for name in PAIRS:
        theirs, ours = getattr(exact, name).flat_grad, getattr(rounded, name).flat_grad
        assert (ours - theirs).norm() <= 0.1 * theirs.norm(), name
        assert not torch.equal(ours, theirs)
    assert rounded.figures() == pytest.approx(exact.figures(), rel=0.02)


def test_pictures_are_moved_at_random() -> None:
    """Each stack by itself, within the reach, and what is behind a window otherwise than what is before it."""
    moves, *_ = draws(Streams(3), rows=400)
    assert set(moves.flatten()) == set(range(-SMALL.shift, SMALL.shift + 1))
    assert not (moves[0] == moves[1]).all(axis=1).all()
    still, moved = (Drq(SMALL.model_copy(update={"shift": s}), SPACES, Streams(3)) for s in (0, 3))
    for agent in (still, moved):
        agent.update(windows(0))
    assert still.figures()["critic_loss"] != moved.figures()["critic_loss"]


def test_returns_of_several_steps() -> None:
    """Rewards up to a termination count, discounted; the value behind a window only where nothing ended in it."""
    agent = Drq(SMALL.model_copy(update={"discount": 0.5}), SPACES, Streams(0))
    agent.critic.flat.zero_()  # which then says 0 of everything
    agent.target.flat.zero_()
    agent.target.parameters()[-1].data.fill_(8.0)
    reward = torch.tensor([[1.0, 2.0, 4.0]]).repeat(4, 1)
    continues = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    agent.update(windows(0, rows=4)._replace(reward=reward, continues=continues))
    targets = np.array([1 + 1 + 1 + 1, 1 + 1 + 1, 1 + 1, 1.0])
    assert agent.figures()["critic_loss"] == pytest.approx(2 * (targets**2).mean(), rel=1e-6)


def test_the_noise_fades() -> None:
    """In a line, by the environment's steps, and no further."""
    agent, deviations = Drq(SMALL, SPACES, Streams(0)), []
    for step in (0, 500, 1000, 5000):
        agent.at(step)
        deviations.append(agent.stddev)
    assert deviations == pytest.approx([1.0, 0.55, 0.1, 0.1])


def test_actions() -> None:
    """The deterministic one is the actor's of frames as they are; others vary about it by the schedule's deviation,
    unclipped but for the bounds, by the stream `explore` alone. What is not a frame is not looked at.
    """
    streams = Streams(3)
    agent = with_biases(Drq(SMALL.model_copy(update={"stddev_clip": 0.01}), SPACES, streams))
    frames = scenes(1, frames=FRAMES)
    textbook = ReferenceDrq(agent)
    mean = torch.tanh(textbook.actor(textbook.encoder(frames.flatten(1, 2).float()))[0])[0].detach().numpy()
    seen = Obs(np.zeros(5, np.float32), frames[0].numpy())
    np.testing.assert_allclose(agent.act(seen, explore=False), mean, rtol=1e-4, atol=1e-5)
    assert (
        agent.act(seen._replace(state=np.ones(5, np.float32)), explore=False).tobytes()
        == agent.act(seen, explore=False).tobytes()
    )
    agent.at(1000)
    before = streams.torch("agent").get_state()
    samples = np.stack([agent.act(seen, explore=True) for _ in range(300)])
    assert samples.dtype == np.float32
    np.testing.assert_allclose(samples.std(axis=0), 0.1, rtol=0.2)
    agent.at(0)
    assert np.abs([agent.act(seen, explore=True) for _ in range(50)]).max() == np.float32(1 - 1e-6)
    assert torch.equal(before, streams.torch("agent").get_state())


def test_the_density_of_any_action() -> None:
    """A normal one about the deterministic action, at the present deviation; finite at the bounds."""
    agent = with_biases(Drq(SMALL, SPACES, Streams(0)))
    agent.at(700)
    frames, act = scenes(6, frames=FRAMES), torch.linspace(-1, 1, 6 * ACT).view(6, ACT)
    means = torch.from_numpy(np.stack([agent.act(Obs(np.zeros(5), f), explore=False) for f in frames.numpy()]))
    expected = torch.distributions.Normal(means, agent.stddev).log_prob(act).sum(-1)
    torch.testing.assert_close(agent.log_prob(frames, act), expected, rtol=1e-4, atol=1e-4)


def test_figures_before_the_first_update() -> None:
    figures = Drq(SMALL, SPACES, Streams(0)).figures()
    assert list(figures) == ["critic_loss", "actor_loss", "stddev"]
    assert all(math.isnan(figure) for figure in figures.values())


def test_reset_critic() -> None:
    """A reset draws other critics, their trunk too, and forgets their optimiser; encoder and actor stay."""
    agent = Drq(SMALL, SPACES, Streams(1))
    for seed in range(3):
        agent.update(windows(seed))
    before = agent.state_dict()
    agent.reset_critic()
    after = agent.state_dict()
    assert torch.equal(after["tensors"]["critic"], after["tensors"]["target"])
    assert not any(moment.any() for moment in after["optimisers"]["critic"].values())
    for name in ("encoder", "actor"):
        assert torch.equal(before["tensors"][name], after["tensors"][name])
        assert_same(before["optimisers"][name], after["optimisers"][name])
    trunk, bias, gain, offset, *_ = (param.detach() for param in agent.critic.parameters())
    torch.testing.assert_close(trunk @ trunk.t(), torch.eye(10), rtol=0, atol=1e-5)
    assert (gain == 1).all()
    assert not bias.any()
    assert not offset.any()


def train(agent: Drq, seeds: range) -> None:
    for seed in seeds:
        agent.at(10 * seed)
        agent.update(windows(seed))
        agent.act(Obs(np.zeros(5), scenes(1, seed, FRAMES)[0].numpy()), explore=True)


@pytest.mark.slow
def test_resumes_bit_for_bit(tmp_path: Path) -> None:
    """Saved after some updates and loaded into a fresh agent, here and in another process, it continues identically."""
    streams = Streams(7)
    agent = Drq(SMALL, SPACES, streams)
    train(agent, range(3))
    torch.save({"agent": agent.state_dict(), "streams": streams.state_dict()}, tmp_path / "saved.pt")
    train(agent, range(3, 6))
    program = f"import tests.rrm.agents.test_drqv2 as t; t.resume_from({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[3])
    resume_from(str(tmp_path), output="here.pt")
    for name in ("here.pt", "there.pt"):
        assert_same(agent.state_dict(), torch.load(tmp_path / name))


def resume_from(folder: str, output: str = "there.pt") -> None:
    """Load, continue as the test above does, and leave the final state behind."""
    saved = torch.load(Path(folder) / "saved.pt")
    streams = Streams(7)
    agent = Drq(SMALL, SPACES, streams)
    agent.load_state_dict(saved["agent"])
    streams.load_state_dict(saved["streams"])
    train(agent, range(3, 6))
    torch.save(agent.state_dict(), Path(folder) / output)


def test_other_batch_sizes() -> None:
    agent = Drq(SMALL, SPACES, Streams(2))
    for rows in (7, 35, 1):
        agent.update(windows(rows, rows))
    assert all(math.isfinite(figure) for figure in agent.figures().values())


def test_state_is_a_copy() -> None:
    agent = Drq(SMALL, SPACES, Streams(0))
    state = agent.state_dict()
    kept = state["tensors"]["encoder"].clone()
    train(agent, range(2))
    assert torch.equal(kept, state["tensors"]["encoder"])


def test_refuses_a_state_of_other_sizes() -> None:
    state = Drq(SMALL, SPACES, Streams(0)).state_dict()
    wider = SMALL.model_copy(update={"channels": 5})
    with pytest.raises(CheckpointError, match="saved agent's encoder has shape"):
        Drq(wider, SPACES, Streams(0)).load_state_dict(state)


def test_refuses_an_infinite_action() -> None:
    agent = Drq(SMALL, SPACES, Streams(0))
    agent.actor.flat.fill_(math.nan)
    with pytest.raises(NumericalError, match="the action after 0 updates"):
        agent.act(Obs(np.zeros(5), scenes(1, frames=FRAMES)[0].numpy()), explore=False)
