"""The discriminator on what a camera shows: g and h read features of frames, and what the robot knows of itself.

An encoder of its own, of the shape of the agent's, is trained by the same loss through both nets; what it has learned
stays with g, and is lent to agents (paper, "Imitation rewards" and "Fairness of the pre-trained encoder").
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Self, cast

import torch
from torch import Generator, Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, layer_norm

from rrm.config import DrqConfig, ImitationConfig
from rrm.devices import CPU
from rrm.envs.spaces import FrameSpace
from rrm.imitation.discriminator import Discriminator, experts_first
from rrm.nets.encoder import Encoder, Pass
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.types import Batch, State

if TYPE_CHECKING:
    from rrm.interfaces import Agent, VisualAgent


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
        *,
        precision: Precision = "float32",
        device: str = CPU,
    ) -> None:
        self.agent, self.frames, self.known = agent, frames, known
        self.encoder = Encoder(agent, frames, generator, precision, device)
        self.projection = StackedMLP(
            1, self.encoder.outputs, 1, 0, agent.features, init="torch", generator=generator, device=device
        )
        self.outputs = agent.features + known.stop - known.start

    def __call__(self, stacks: Tensor, obs: Tensor) -> Tensor:
        """Float32 [B, outputs] of uint8 [B, stack, channels, height, width] and obs [B, O], without gradient."""
        with torch.no_grad():
            return self.shown(self.encoder.encode(stacks), obs)

    def shown(self, features: Tensor, obs: Tensor) -> Tensor:
        """The same of features [B, R], differentiable in them."""
        projected = _through(self.projection, features).t()
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
        device: str = CPU,
    ) -> None:
        super().__init__(
            config, eye.outputs, act_dim, discount, generator=generator, precision=precision, device=device
        )
        self.eye = eye
        self._add(encoder=eye.encoder, projection=eye.projection)
        self._pass = Pass(eye.encoder, 4 * config.minibatch)
        self._autograd = (self.g.net, self.h, eye.projection)
        for net in self._autograd:
            for leaf, grad in zip(net.parameters(), net.grads, strict=True):
                leaf.grad = grad

    def density(self, agent: Agent, batch: Batch) -> Tensor:
        assert batch.frames is not None  # as everywhere here: the run's agent sees them
        return cast("VisualAgent", agent).log_prob(batch.frames[:, : self.eye.frames.stack], batch.act)

    @torch.no_grad()
    def f(self, batch: Batch) -> Tensor:
        stacks, windows = self._states(batch)
        g, h = self._told(self.eye.encoder.encode(stacks), windows)
        return (g + self._shaping(windows, h)).view(batch.reward.shape)

    @torch.no_grad()
    def reward(self, batch: Batch) -> Tensor:
        stacks, windows = self._states(batch)
        return self._told(self.eye.encoder.encode(stacks), windows)[0].view(batch.reward.shape)

    def step(self, both: Batch, log_prob: Tensor) -> float:
        stacks, windows = self._states(both)
        if len(self._pass.features) != len(stacks):
            self._pass = Pass(self.eye.encoder, len(stacks))
        features = self._pass.forward(stacks).detach().float().requires_grad_()
        for net in self._autograd:
            net.flat_grad.zero_()
        is_expert = experts_first(both)
        g, h = self._told(features, windows)
        if self.config.pretrain == "airl":
            logit = (g + self._shaping(windows, h))[:, 0] - log_prob
            loss = binary_cross_entropy_with_logits(logit, is_expert)
        else:
            loss = (g[:, 0] - is_expert).square().mean()
        loss.backward()  # type: ignore[no-untyped-call]
        assert features.grad is not None
        self._pass.backward(features.grad.to(self.eye.encoder.dtype))
        self._descend(loss.detach(), self.nets)
        return float(self.g.net.flat_grad.norm())

    def _states(self, batch: Batch) -> tuple[Tensor, Batch]:
        """What is seen at every state of a batch, a window's one behind the other; and the batch as windows [B, T]:
        transitions are windows of one step.
        """
        assert batch.frames is not None
        stacks = batch.frames.unfold(1, self.eye.frames.stack, 1).movedim(-1, 2).flatten(0, 1)
        if batch.act.ndim == 2:
            columns = {name: column.unsqueeze(1) for name, column in batch._asdict().items() if name != "frames"}
            batch = batch._replace(**columns)
        return stacks, batch

    def _told(self, features: Tensor, windows: Batch) -> tuple[Tensor, Tensor]:
        """What g says of every step of windows, [B, T], and h of every state, [B, T + 1], by the states' features."""
        obs = torch.cat((windows.obs, windows.next_obs[:, -1:]), dim=1)
        states = self.eye.shown(features, obs.flatten(0, 1)).view(*obs.shape[:2], -1)
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
