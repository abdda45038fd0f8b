"""The discriminator on what a camera shows: g and h read features of frames, and what the robot knows of itself.

An encoder of its own, of the shape of the agent's, is trained by the same loss through both nets; what it has learned
stays with g, and is lent to agents (paper, "Imitation rewards" and "Fairness of the pre-trained encoder").
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Self, cast

import torch
from torch import Generator, Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, layer_norm

from rrm.config import DrqConfig, ImitationConfig
from rrm.envs.spaces import FrameSpace
from rrm.imitation.discriminator import Discriminator
from rrm.nets.encoder import Encoder
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.types import Batch, State

if TYPE_CHECKING:
    from rrm.interfaces import Agent, VisualAgent

_WINDOWS = 64  #: that go through the encoder together


class Eye:
    """What g and h are shown of a state: numbers made of its frames, and some of its observation.

    Args:
        agent: whose encoder this one is like, and who makes as many numbers of its features.
        known: the part of an observation that is shown beside them, "proprioception".
        generator: None leaves all weights zero, to be loaded.
    """

    def __init__(
        self,
        agent: DrqConfig,
        frames: FrameSpace,
        known: slice,
        generator: Generator | None,
        precision: Precision = "float32",
    ) -> None:
        self.agent, self.frames, self.known = agent, frames, known
        self.encoder = Encoder(agent, frames, generator, precision)
        self.projection = StackedMLP(1, self.encoder.outputs, 1, 0, agent.features, init="torch", generator=generator)
        self.outputs = agent.features + known.stop - known.start

    def __call__(self, stacks: Tensor, obs: Tensor) -> Tensor:
        """Float32 [B, outputs] of uint8 [B, stack, channels, height, width] and obs [B, O]; differentiable."""
        features = self.encoder.plain if torch.is_grad_enabled() else self.encoder.encode
        projected = _through(self.projection, features(stacks)).t()
        return torch.cat((torch.tanh(layer_norm(projected, projected.shape[1:])), obs[:, self.known]), dim=1)

    def described(self) -> State:
        """What `kept` makes one like it of."""
        agent = {"channels": self.agent.channels, "strides": [*self.agent.strides], "features": self.agent.features}
        return {**agent, "frames": asdict(self.frames), "known": [self.known.start, self.known.stop]}

    @classmethod
    def kept(cls, prior: State) -> Self:
        """The one that belongs to the prior in a run's file."""
        shape = dict(prior["eye"])
        frames, known = FrameSpace(**shape.pop("frames")), slice(*shape.pop("known"))
        eye = cls(DrqConfig(kind="drqv2", **shape), frames, known, None)
        eye.encoder.flat.copy_(prior["encoder"])
        eye.projection.flat.copy_(prior["projection"])
        return eye


class VisualDiscriminator(Discriminator):
    """Of transitions with their frames, or windows of them."""

    most, at_once = 2048, 256

    def __init__(
        self,
        config: ImitationConfig,
        eye: Eye,
        act_dim: int,
        discount: float,
        *,
        generator: Generator,
        precision: Precision = "float32",
    ) -> None:
        super().__init__(config, eye.outputs, act_dim, discount, generator=generator, precision=precision)
        self.eye = eye
        self._add(encoder=eye.encoder, projection=eye.projection)
        for net in (self.g.net, self.h, eye.projection):  # as the encoder's: autograd adds to them
            for leaf, grad in zip(net.parameters(), net.grads, strict=True):
                leaf.grad = grad

    def density(self, agent: Agent, batch: Batch) -> Tensor:
        seen = _frames(batch)[:, : self.eye.frames.stack]
        return cast("VisualAgent", agent).log_prob(seen, batch.act)

    @torch.no_grad()
    def f(self, batch: Batch) -> Tensor:
        told = ((part, *self._told(part)) for part in _windows(batch))
        return torch.cat([g + self._shaping(part, h) for part, g, h in told]).view(batch.reward.shape)

    @torch.no_grad()
    def reward(self, batch: Batch) -> Tensor:
        return torch.cat([self._told(part)[0] for part in _windows(batch)]).view(batch.reward.shape)

    def step(self, both: Batch, log_prob: Tensor) -> float:
        count = len(both.act)
        is_expert = torch.zeros(count, 1).index_fill_(0, torch.arange(count // 2), 1.0)
        for net in self.nets.values():
            net.flat_grad.zero_()
        total = torch.zeros(())
        targets = zip(*(torch.split(column, _WINDOWS) for column in (is_expert, log_prob[:, None])), strict=True)
        for part, (target, density) in zip(_windows(both), targets, strict=True):
            g, h = self._told(part)
            if self.config.pretrain == "airl":
                logit = g + self._shaping(part, h) - density
                loss = binary_cross_entropy_with_logits(logit, target, reduction="sum") / count
            else:
                loss = (g - target).square().sum() / count
            loss.backward()  # type: ignore[no-untyped-call]
            total += loss.detach()
        self._descend(total, self.nets)
        return float(self.g.net.flat_grad.norm())

    def _told(self, windows: Batch) -> tuple[Tensor, Tensor]:
        """What g says of every step of windows, [B, T], and h of every state, [B, T + 1]."""
        stacks = _frames(windows).unfold(1, self.eye.frames.stack, 1).movedim(-1, 2)
        obs = torch.cat((windows.obs, windows.next_obs[:, -1:]), dim=1)
        states = self.eye(stacks.flatten(0, 1), obs.flatten(0, 1)).view(*obs.shape[:2], -1)
        steps = torch.cat((states[:, :-1], windows.act), dim=-1)
        g, h = (_through(net, x.flatten(0, 1)).view(x.shape[:2]) for net, x in ((self.g.net, steps), (self.h, states)))
        return self.g.headed(g), h

    def _shaping(self, windows: Batch, h: Tensor) -> Tensor:
        return self.discount * windows.continues * h[:, 1:] - h[:, :-1]

    def described(self) -> State:
        return super().described() | {"eye": self.eye.described()}


def _through(net: StackedMLP, x: Tensor) -> Tensor:
    """What a stack of one network says, [out, B], differentiable also in x [B, in]."""
    return (net.plain if torch.is_grad_enabled() else net)(x)[0]


def _windows(batch: Batch) -> Iterator[Batch]:
    """Windows [B, T] of few at a time; transitions are windows of one step."""
    if batch.act.ndim == 2:
        columns = {name: column.unsqueeze(1) for name, column in batch._asdict().items() if name != "frames"}
        batch = batch._replace(**columns)
    for rows in torch.split(torch.arange(len(batch.act)), _WINDOWS):
        yield Batch(*(column[rows] for column in batch if column is not None))


def _frames(batch: Batch) -> Tensor:
    assert batch.frames is not None  # the run's agent sees frames
    return batch.frames
