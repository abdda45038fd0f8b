"""The fast SAC against the textbook one, its state, and what it promises to the training loop."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from rrm.agents.sac import Sac
from rrm.config import SacConfig
from rrm.envs import Spaces
from rrm.errors import CheckpointError, NumericalError
from rrm.nets.mlp import StackedMLP
from rrm.seeding import Streams
from rrm.types import Batch, Obs, State
from tests.rrm.agents.reference_sac import ReferenceSac, unstack

SMALL = SacConfig(hidden=24, layers=2, batch=16, actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-2)


def make_batch(rows: int, obs: int, act: int, seed: int) -> Batch:
    g = torch.Generator().manual_seed(seed)
    return Batch(
        obs=torch.randn(rows, obs, generator=g),
        act=torch.rand(rows, act, generator=g) * 2 - 1,
        prior=torch.zeros(rows),
        reward=torch.randn(rows, generator=g),
        next_obs=torch.randn(rows, obs, generator=g),
        continues=(torch.rand(rows, generator=g) > 0.2).float(),
    )


def flat_weights(networks: nn.Module) -> Tensor:
    return torch.cat([p.detach().flatten() for p in networks.parameters()])


def flat_grads(networks: nn.Module) -> Tensor:
    return torch.cat([p.grad.flatten() for p in networks.parameters() if p.grad is not None])


def stacked_grads(net: StackedMLP) -> Tensor:
    """In the order of the textbook's networks."""
    twin = StackedMLP(net.members, net.widths[0], net.widths[1], len(net.widths) - 2, net.widths[-1], generator=None)
    twin.flat.copy_(net.flat_grad)
    return flat_weights(unstack(twin))


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    obs=st.integers(1, 45),
    act=st.integers(1, 9),
    hidden=st.integers(2, 70),
    layers=st.integers(1, 4),
    rows=st.integers(1, 70),
    target_every=st.integers(1, 3),
    seed=st.integers(0, 10**6),
)
@example(obs=1, act=2, hidden=60, layers=3, rows=2, target_every=1, seed=6250)
@example(obs=34, act=5, hidden=65, layers=3, rows=4, target_every=1, seed=49315)
def test_equals_textbook(obs: int, act: int, hidden: int, layers: int, rows: int, target_every: int, seed: int) -> None:
    """Losses, gradients, parameters and target follow plain autograd over several updates, whatever the sizes."""
    follow_textbook(
        SacConfig(hidden=hidden, layers=layers, batch=rows, target_every=target_every, tau=0.1), obs, act, seed
    )


@pytest.mark.parametrize("hidden", [8, 24, 130])
def test_normalised_critics_equal_textbook(hidden: int) -> None:
    """So do critics with layer normalisation."""
    follow_textbook(SacConfig(hidden=hidden, batch=32, tau=0.1, critic_norm="layer"), 39, 4, seed=hidden)


def follow_textbook(config: SacConfig, obs: int, act: int, seed: int) -> None:
    rows = config.batch
    streams = Streams(seed)
    sac = Sac(config, Spaces(obs, act), streams)
    plain = ReferenceSac(config, sac.actor, sac.critic)
    draws = torch.Generator()
    draws.set_state(streams.torch("agent").get_state())
    for update in range(4):
        batch = make_batch(rows, obs, act, seed + update)
        noise_next, noise = torch.empty(act, 2 * rows).normal_(generator=draws).t().split(rows)
        expected = plain.update(batch, noise_next, noise)
        sac.update(batch)
        assert expected == pytest.approx(sac.figures(), rel=1e-4, abs=1e-5)
        for ours, theirs in ((sac.actor, plain.actor), (sac.critic, plain.critics)):
            expected_grad = flat_grads(theirs)
            # As a whole: a unit that rounding puts on the other side of zero changes a few entries, by one row's share.
            assert (stacked_grads(ours) - expected_grad).norm() <= (2e-3 + 4e-2 / rows) * expected_grad.norm()
    for ours, theirs in ((sac.critic, plain.critics), (sac.target, plain.targets), (sac.actor, plain.actor)):
        weights, textbook = flat_weights(unstack(ours)), flat_weights(theirs)
        apart = (weights - textbook).abs()
        # Adam makes a whole step of a gradient that is nothing but rounding: a few weights may be so far apart.
        assert (apart > 1e-4 + 1e-3 * textbook.abs()).sum() <= 2 + len(apart) // 1000
        assert apart.max() <= 2 * 4 * config.actor_lr
    assert plain.log_alpha.item() == pytest.approx(sac.log_alpha.item(), abs=1e-6)


def test_actions() -> None:
    """Deterministic actions are tanh of the mean; samples vary, stay in [-1, 1] and use the explore stream alone."""
    streams = Streams(3)
    sac = Sac(SMALL, Spaces(5, 2), streams)
    before = streams.torch("agent").get_state()
    obs = np.linspace(-1, 1, 5, dtype=np.float32)
    mean = unstack(sac.actor)[0](torch.from_numpy(obs))[:2].tanh().detach().numpy()
    np.testing.assert_allclose(sac.act(Obs(obs), explore=False), mean, rtol=1e-5, atol=1e-6)
    samples = np.stack([sac.act(Obs(obs), explore=True) for _ in range(50)])
    assert samples.dtype == np.float32
    assert np.abs(samples).max() <= 1
    assert samples.std(axis=0).min() > 0.1
    assert torch.equal(before, streams.torch("agent").get_state())


def test_actions_do_not_share_memory() -> None:
    """An action stays what it was when the next one is taken."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(3))
    first = sac.act(Obs(np.ones(5, np.float32)), explore=False)
    kept = first.copy()
    sac.act(Obs(-np.ones(5, np.float32)), explore=False)
    np.testing.assert_array_equal(kept, first)


def test_saturated_policy_stays_finite() -> None:
    """Where tanh rounds to one, losses and parameters stay finite."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(0))
    sac.actor.flat[-16:] = 40.0
    for seed in range(3):
        sac.update(make_batch(16, 5, 2, seed))
    assert all(math.isfinite(figure) for figure in sac.figures().values())
    assert sac.actor.flat.isfinite().all()


def test_metrics_before_the_first_update() -> None:
    """Before the first update every figure is NaN."""
    figures = Sac(SMALL, Spaces(5, 2), Streams(0)).figures()
    assert list(figures) == ["critic_loss", "actor_loss", "entropy", "alpha"]
    assert all(math.isnan(figure) for figure in figures.values())


def test_reset_critic() -> None:
    """A reset draws another critic, copies it to the target and forgets its optimiser; actor and temperature stay."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(1))
    for seed in range(3):
        sac.update(make_batch(16, 5, 2, seed))
    before = sac.state_dict()
    sac.reset_critic()
    after = sac.state_dict()
    assert not torch.equal(before["tensors"]["critic"], after["tensors"]["critic"])
    assert torch.equal(after["tensors"]["critic"], after["tensors"]["target"])
    assert all(not moment.any() for moment in after["optimisers"]["critic"].values())
    assert torch.equal(before["tensors"]["actor"], after["tensors"]["actor"])
    assert torch.equal(before["tensors"]["log_alpha"], after["tensors"]["log_alpha"])
    assert before["optimisers"]["actor"]["steps"] == after["optimisers"]["actor"]["steps"] == 3
    for weight in sac.critic.parameters()[2:-2:2]:
        for member in weight.detach():
            torch.testing.assert_close(member @ member.t(), torch.eye(24), rtol=0, atol=1e-5)


def train(sac: Sac, seeds: range) -> None:
    for seed in seeds:
        sac.update(make_batch(16, 5, 2, seed))
        sac.act(Obs(np.full(5, seed, np.float32)), explore=True)


def assert_same(a: State, b: State) -> None:
    """Equal to the last bit, NaN included."""
    assert a.keys() == b.keys()
    for key, value in a.items():
        if isinstance(value, dict):
            assert_same(value, b[key])
        elif isinstance(value, Tensor):
            assert torch.equal(value.nan_to_num(nan=-1e9), b[key].nan_to_num(nan=-1e9)), key
        else:
            assert value == b[key]


@pytest.mark.slow
def test_resumes_bit_for_bit(tmp_path: Path) -> None:
    """Saved after some updates and loaded into a fresh agent, here and in another process, it continues identically."""
    streams = Streams(7)
    sac = Sac(SMALL, Spaces(5, 2), streams)
    train(sac, range(5))
    torch.save({"sac": sac.state_dict(), "streams": streams.state_dict()["torch"]}, tmp_path / "saved.pt")
    train(sac, range(5, 9))
    sac.reset_critic()
    train(sac, range(9, 12))

    program = f"import tests.rrm.agents.test_sac as t; t.resume_from({str(tmp_path)!r})"
    root = Path(__file__).parents[3]
    subprocess.run([sys.executable, "-c", program], check=True, cwd=root)
    resume_from(str(tmp_path), output="here.pt")
    for name in ("here.pt", "there.pt"):
        assert_same(sac.state_dict(), torch.load(tmp_path / name))


def resume_from(folder: str, output: str = "there.pt") -> None:
    """Load, continue as the test above does, and leave the final state behind."""
    saved = torch.load(Path(folder) / "saved.pt")
    streams = Streams(7)
    sac = Sac(SMALL, Spaces(5, 2), streams)
    sac.load_state_dict(saved["sac"])
    streams.load_state_dict({"numpy": {}, "torch": saved["streams"]})
    train(sac, range(5, 9))
    sac.reset_critic()
    train(sac, range(9, 12))
    torch.save(sac.state_dict(), Path(folder) / output)


def test_does_not_depend_on_alignment() -> None:
    """A batch that starts at an odd address gives the same update, to the last bit."""
    aligned, shifted = (Sac(SMALL, Spaces(5, 2), Streams(2)) for _ in range(2))
    batch = make_batch(16, 5, 2, 0)
    moved = (
        torch.cat((torch.zeros(3), column.flatten()))[3:].view_as(column) for column in batch if column is not None
    )
    aligned.update(batch)
    shifted.update(Batch(*moved))
    assert_same(aligned.state_dict(), shifted.state_dict())


def test_other_batch_sizes() -> None:
    """A batch of another size than the configured one is as good."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(2))
    for rows in (7, 16, 1):
        sac.update(make_batch(rows, 5, 2, rows))
    assert all(math.isfinite(figure) for figure in sac.figures().values())


def test_q_values() -> None:
    """Q values are those of the two critics, by their own parameters or by those given."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(2))
    batch = make_batch(4, 5, 2, 0)
    joined = torch.cat((batch.obs, batch.act), dim=-1)
    expected = torch.stack([critic(joined).squeeze(-1) for critic in unstack(sac.critic)])
    torch.testing.assert_close(sac.q_values(batch.obs, batch.act), expected)
    params = [torch.zeros_like(p) for p in sac.critic.parameters()]
    params[-1] += torch.tensor([3.0, 4.0]).view(2, 1, 1)
    assert sac.q_values(batch.obs, batch.act, params).tolist() == [[3.0] * 4, [4.0] * 4]


def test_state_is_a_copy() -> None:
    """A saved state does not change when training goes on."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(0))
    state = sac.state_dict()
    kept = state["tensors"]["critic"].clone()
    train(sac, range(2))
    assert torch.equal(kept, state["tensors"]["critic"])


def test_refuses_a_state_of_other_sizes() -> None:
    """A state of an agent with other sizes is refused by name."""
    state = Sac(SMALL, Spaces(5, 2), Streams(0)).state_dict()
    with pytest.raises(CheckpointError, match="saved agent's actor has shape"):
        Sac(SMALL, Spaces(6, 2), Streams(0)).load_state_dict(state)


def test_refuses_an_infinite_action() -> None:
    """An observation that is not finite is reported where it becomes an action."""
    sac = Sac(SMALL, Spaces(5, 2), Streams(0))
    with pytest.raises(NumericalError, match="not finite"):
        sac.act(Obs(np.array([0, 0, np.nan, 0, 0], np.float32)), explore=False)


@pytest.mark.slow
def test_solves_a_bandit() -> None:
    """Rewarded for closeness to a hidden action, the policy finds it and lowers its temperature."""
    streams = Streams(0)
    sac = Sac(SMALL.model_copy(update={"discount": 0.0, "batch": 64}), Spaces(3, 1), streams)
    g = torch.Generator().manual_seed(0)
    for _ in range(1500):
        obs = torch.rand(64, 3, generator=g) * 2 - 1
        act = torch.rand(64, 1, generator=g) * 2 - 1
        reward = -10 * (act[:, 0] - 0.8 * obs[:, 0]).square()
        sac.update(Batch(obs, act, torch.zeros(64), reward, obs, torch.ones(64)))
    for x in (-0.9, -0.3, 0.4, 0.8):
        assert sac.act(Obs(np.array([x, 0.1, -0.1], np.float32)), explore=False)[0] == pytest.approx(0.8 * x, abs=0.12)


def test_the_density_of_any_action() -> None:
    """Log density of given actions, by the change of variables in double precision; samples' own to rounding."""
    agent = Sac(SMALL, Spaces(3, 2), Streams(0))
    batch = make_batch(64, 3, 2, 1)
    head = agent.actor(batch.obs)[0].detach().double()
    mean, log_std = head[:2], -5 + 3.5 * (torch.tanh(head[2:]) + 1)
    act = batch.act.t().double()
    normal = torch.distributions.Normal(mean, log_std.exp()).log_prob(torch.atanh(act))
    expected = (normal - torch.log1p(-act.square())).sum(dim=0)
    torch.testing.assert_close(agent.log_prob(batch.obs, batch.act).double(), expected, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("bound", [1.0, -1.0])
def test_the_density_of_a_saturated_action_is_finite(bound: float) -> None:
    """Experts, and a float32 tanh, act at the very bound, where atanh is infinite."""
    agent = Sac(SMALL, Spaces(3, 2), Streams(0))
    obs = make_batch(8, 3, 2, 1).obs
    density = agent.log_prob(obs, torch.full((8, 2), bound))
    assert torch.isfinite(density).all()
    near = agent.log_prob(obs, torch.full((8, 2), bound * (1 - 1e-6)))
    torch.testing.assert_close(density, near)
