"""The discriminator on images: its gradient against autograd all the way, what it tells apart, what it leaves."""

import pytest
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, layer_norm

from rrm.config import DrqConfig, ImitationConfig
from rrm.envs.spaces import FrameSpace
from rrm.imitation.discriminator import joined
from rrm.imitation.visual import Eye, VisualDiscriminator
from rrm.types import Batch

GAMMA, STACK = 0.9, 2
AGENT = DrqConfig(kind="drqv2", channels=4, strides=(2, 1), features=6)
FRAMES = FrameSpace(12, 10, channels=3, stack=STACK)


def make(known=slice(1, 4), **changes):
    config = ImitationConfig(**{"hidden": 8, "layers": 2, "lr": 1e-2, "minibatch": 5} | changes)
    generator = torch.Generator().manual_seed(0)
    eye = Eye(AGENT, FRAMES, known, generator)
    eye.encoder.flat.add_(0.05 * torch.randn(eye.encoder.flat.shape, generator=generator))  # biases, too
    return VisualDiscriminator(config, eye, 2, GAMMA, generator=generator)


def batch(seed, count=5, steps=()):
    """Transitions [count], or windows [count, *steps]."""
    generator = torch.Generator().manual_seed(seed)
    obs = torch.randn(count, sum(steps) + 1 if steps else 2, 5, generator=generator)
    act = torch.rand(count, *steps, 2, generator=generator) * 2 - 1
    blank, continues = torch.zeros(count, *steps), (torch.rand(count, *steps, generator=generator) > 0.4).float()
    behind = STACK + sum(steps or (1,))
    frames = torch.randint(256, (count, behind, *FRAMES.planar), dtype=torch.uint8, generator=generator)
    here, after = (obs[:, :-1], obs[:, 1:]) if steps else (obs[:, 0], obs[:, 1])
    return Batch(here, act, blank, blank, after, continues, frames)


@pytest.mark.parametrize("head", ["linear", "tanh"])
@pytest.mark.parametrize("pretrain", ["airl", "mse"])
def test_a_step_is_that_of_autograd_through_the_encoder(head, pretrain):
    """Weights of encoder, projection, g and h after three steps, as plain code and one Adam have them."""
    net = make(head=head, pretrain=pretrain)
    nets = {"encoder": net.eye.encoder, "projection": net.eye.projection, "g": net.g.net, "h": net.h}
    begun = {name: each.flat.clone() for name, each in nets.items()}
    params = {name: [p.detach().clone().requires_grad_() for p in each.parameters()] for name, each in nets.items()}
    adam = torch.optim.Adam([p for each in params.values() for p in each], lr=1e-2)

    def seen(frames, obs):
        projected = nets["projection"].plain(nets["encoder"].plain(frames, params["encoder"]), params["projection"])
        return torch.cat((torch.tanh(layer_norm(projected[0].t(), (6,))), obs[:, 1:4]), dim=1)

    for seed in range(3):
        both = joined(batch(seed), batch(seed + 10))
        log_prob = torch.randn(10, generator=torch.Generator().manual_seed(seed))
        label = torch.cat((torch.ones(5), torch.zeros(5)))
        here, after = seen(both.frames[:, :STACK], both.obs), seen(both.frames[:, 1:], both.next_obs)
        reward = nets["g"].plain(torch.cat((here, both.act), dim=1), params["g"])[0, 0]
        reward = torch.tanh(reward) if head == "tanh" else reward
        value, following = (nets["h"].plain(states, params["h"])[0, 0] for states in (here, after))
        f = reward + GAMMA * both.continues * following - value
        airl, mse = binary_cross_entropy_with_logits(f - log_prob, label), (reward - label).square().mean()
        adam.zero_grad()
        (airl if pretrain == "airl" else mse).backward()
        expected = torch.cat([p.grad.flatten() for p in params["g"]]).norm()
        adam.step()
        assert net.step(both, log_prob) == pytest.approx(float(expected), rel=1e-3)
    for name, each in nets.items():
        for ours, theirs in zip(each.parameters(), params[name], strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-4)
        assert (name == "h" and pretrain == "mse") or not torch.equal(each.flat, begun[name])


def test_of_windows_it_says_what_it_says_of_their_steps():
    """Both f and g, of [B, T]."""
    net, windows = make(), batch(3, 4, (3,))
    for told in (net.f, net.reward):
        for step in range(3):
            single = Batch(*(column[:, step] for column in windows[:6]), windows.frames[:, step : step + STACK + 1])
            torch.testing.assert_close(told(windows)[:, step], told(single), rtol=1e-5, atol=1e-6)


def test_a_termination_ends_the_bootstrap():
    """Behind it nothing that is seen counts."""
    net, steps = make(), batch(1)
    other = steps._replace(frames=torch.cat((steps.frames[:, :STACK], 255 - steps.frames[:, STACK:]), dim=1))
    ended, going = torch.zeros(5), torch.ones(5)
    assert torch.equal(net.f(steps._replace(continues=ended)), net.f(other._replace(continues=ended)))
    assert (net.f(steps._replace(continues=going)) != net.f(other._replace(continues=going))).all()


def test_it_tells_by_pictures_alone():
    """Where nothing else differs: g is higher on what the expert saw."""
    net = make(known=slice(0, 0))
    same = batch(0, 8)._replace(act=torch.zeros(8, 2))
    expert, policy = (same._replace(frames=same.frames // 4 + shade) for shade in (120, 60))
    for _ in range(30):
        net.step(joined(expert, policy), torch.zeros(16))
    assert net.reward(expert).min() > net.reward(policy).max() + 1


def test_what_is_kept_makes_the_same_features():
    """Through the description and the weights alone, as a file has them."""
    net = make()
    again = Eye.kept(net.described() | net.kept())
    steps = batch(2)
    seen = steps.frames[:, :STACK], steps.obs
    assert torch.equal(again(*seen), net.eye(*seen))
    assert (again.frames, again.outputs, net.described()["obs_dim"]) == (FRAMES, 9, 9)


def test_saved_and_loaded_it_goes_on_alike():
    """Every net and its moments."""
    first, second = make(), make()
    first.step(joined(batch(0), batch(1)), torch.zeros(10))
    second.load_state_dict(first.state_dict())
    for net in (first, second):
        net.step(joined(batch(2), batch(3)), torch.zeros(10))
    assert all(torch.equal(each.flat, second.nets[name].flat) for name, each in first.nets.items())
