"""DrQ-v2 (Yarats et al. 2021): a deterministic actor and twin critics on the features of a convolutional encoder.

An update moves the pictures at random, regresses the critics on n-step returns and with them trains the encoder, then
ascends the smaller critic by the actor, on the features as they were; the target of the critics follows. The way
through encoder and trunks is written out; `tests/rrm/agents/reference_drqv2.py` is the same algorithm in plain
autograd, and the tests hold the two together. The agent sees frames and nothing else.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor

from rrm.agents.checks import finite_action, finite_figures, restore, saved
from rrm.nets.adam import FlatAdam
from rrm.nets.encoder import Encoder, Pass
from rrm.nets.tower import Tower, product, project
from rrm.transfers import to

if TYPE_CHECKING:
    from rrm.config import DrqConfig
    from rrm.envs.spaces import Spaces
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Batch, Floats, Obs, State

_LARGEST = 1 - 1e-6  #: of an action


class Drq:
    """An `rrm.interfaces.Agent` whose batches are windows of steps.

    Args:
        spaces: of frames and actions.
        streams: `init` draws weights, `agent` the noise of updates, `explore` that of actions taken, `shift` how far
            pictures are moved.
        precision: of the convolutions and of the products of features (`rrm.nets.precision`); what follows is float32.
    """

    names: ClassVar[tuple[str, ...]] = ("critic_loss", "actor_loss", "stddev")  #: of its figures

    def __init__(
        self,
        config: DrqConfig,
        spaces: Spaces,
        streams: Streams,
        *,
        precision: Precision = "float32",
        device: str = "cpu",
    ) -> None:
        assert spaces.frames is not None  # the configuration has checked it
        self.config = config
        self.updates = 0  #: finished updates
        self._stack, self._act_dim, self._step, self._device = spaces.frames.stack, spaces.act, 0, device
        self._init = streams.torch("init")  # the same weights on any device
        self._noise = streams.torch("agent", device)
        self._explore = streams.torch("explore", device)
        self._shift = streams.numpy("shift")
        self.encoder = Encoder(config, spaces.frames, self._init, precision, device)
        self.actor = self._tower(1, outputs=spaces.act)
        self.critic = self._tower(2, extra=spaces.act, dropout=self._dropout)
        self.target = self._tower(2, extra=spaces.act, dropout=self._dropout, fresh=False)
        self.target.flat.copy_(self.critic.flat)
        self._figures = torch.full((len(self.names),), math.nan)
        self._nets: dict[str, Encoder | Tower] = {}
        self._adams: dict[str, FlatAdam] = {}
        for name, net in (("encoder", self.encoder), ("actor", self.actor), ("critic", self.critic)):
            self._train(name, net)
        self._passes(config.batch)

    @property
    def _dropout(self) -> float | None:
        """Of the critics; None: they are neither dropped from nor normalised."""
        return None

    def _tower(
        self, members: int, outputs: int = 1, extra: int = 0, dropout: float | None = None, *, fresh: bool = True
    ) -> Tower:
        config = self.config
        return Tower(
            members, self.encoder.outputs, config.features, extra, hidden=config.hidden, layers=config.layers,
            outputs=outputs, generator=self._init if fresh else None, dropout=dropout, device=self._device,
        )  # fmt: skip

    def _train(self, name: str, net: Encoder | Tower) -> None:
        self._nets[name] = net
        self._adams[name] = FlatAdam(net.flat, net.flat_grad, self.config.lr)

    def _passes(self, rows: int) -> None:
        """Places for batches of this size: for the frames that are learned from, and for those behind them."""
        self._now, self._then = Pass(self.encoder, rows), Pass(self.encoder, rows, back=False)

    @property
    def _tensors(self) -> dict[str, Tensor]:
        nets = {name: net.flat for name, net in self._nets.items()}
        return nets | {"target": self.target.flat, "figures": self._figures}

    def at(self, step: int) -> None:
        self._step = step

    @property
    def stddev(self) -> float:
        """Of the noise of actions, at the present step."""
        return self._scheduled(self._step)

    def _scheduled(self, step: int) -> float:
        config = self.config
        share = min(max(step / config.stddev_steps, 0), 1)
        return (1 - share) * config.stddev + share * config.last_stddev

    @torch.no_grad()
    def act(self, obs: Obs, *, explore: bool) -> Floats:
        mean = self._mean(to(self._device, torch.from_numpy(obs.frames)[None]))[0]
        if explore:
            noise = torch.empty_like(mean).normal_(generator=self._explore)
            mean = (mean + self.stddev * noise).clamp(-_LARGEST, _LARGEST)
        action: Floats = mean.cpu().numpy()
        return finite_action(action, self.updates, "the frames of this step")

    def _mean(self, frames: Tensor) -> Tensor:
        (pre,) = project(self.encoder.encode(frames), self.actor)
        return torch.tanh(self.actor.outputs(pre, frozen=True)[-1][0])

    @torch.no_grad()
    def log_prob(self, frames: Tensor, act: Tensor) -> Tensor:
        """Log density of any actions [B, A] at frames [B, stack, channels, height, width], [B]: that of the noise at
        the present standard deviation around the deterministic action, whatever of it lies beyond the bounds.
        """
        stddev = max(self.stddev, 1e-6)
        noise = (act - self._mean(frames)) / stddev
        return (-0.5 * noise.square() - math.log(stddev * math.sqrt(2 * math.pi))).sum(dim=1)

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One step of critics, encoder and actor; the target follows."""
        assert batch.frames is not None
        rows, steps = batch.reward.shape
        if len(self._now.features) != rows:
            self._passes(rows)
        reach, act = self.config.shift, batch.act[:, 0]
        moves = self._shift.integers(-reach, reach + 1, (2, rows, 2))
        noise, noise_next = torch.empty(2, rows, self._act_dim, device=self._device).normal_(generator=self._noise)
        features = self._now.forward(batch.frames[:, : self._stack], moves[0])
        following = self._then.forward(batch.frames[:, steps:], moves[1])

        pre_actor, pre_critic = self._look(features, act)
        reward, discount = self._returns(batch)
        q_target = reward + discount * self._value(following, noise_next)
        critic_loss = self._update_critic(features, pre_critic, act, q_target)
        actor_loss = self._update_actor(features, pre_actor, noise)
        self.target.flat.lerp_(self.critic.flat, self.config.tau)
        self._say({"critic_loss": critic_loss, "actor_loss": actor_loss, "stddev": self.stddev})
        self.updates += 1

    def _say(self, figures: dict[str, float]) -> None:
        for name, figure in figures.items():
            self._figures[self.names.index(name)] = figure

    def _returns(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Discounted sum of the rewards of a window up to a termination, and what a value behind it counts, [B]."""
        discount = (self.config.discount * batch.continues).cumprod(dim=1)
        before = torch.cat((torch.ones_like(discount[:, :1]), discount[:, :-1]), dim=1)
        return (before * batch.reward).sum(dim=1), discount[:, -1]

    def _look(self, features: Tensor, act: Tensor) -> list[Tensor]:  # noqa: ARG002 (DrM's)
        """What the trunks of actor and critics make of the features, before anything is learned."""
        return project(features, self.actor, self.critic)

    def _value(self, features: Tensor, noise: Tensor) -> Tensor:
        """Of the state behind a window, [B]."""
        pre_actor, pre_target = project(features, self.actor, self.target)
        return self._explored(pre_actor, pre_target, noise)

    def _explored(self, pre_actor: Tensor, pre_target: Tensor, noise: Tensor) -> Tensor:
        """What the smaller target says of a sampled action, [B]."""
        act = self._sample(self.actor.outputs(pre_actor)[-1][0], noise)
        return torch.minimum(*self._q(self.target, pre_target, act))

    def _sample(self, raw: Tensor, noise: Tensor) -> Tensor:
        """Actions [B, A] by the actor's output and noise of deviation 1; what exceeds a bound has a gradient still."""
        clip = self.config.stddev_clip
        act = torch.tanh(raw) + (self.stddev * noise).clamp(-clip, clip)
        return act + (act.clamp(-_LARGEST, _LARGEST) - act).detach()

    def _q(self, critic: Tower, pre: Tensor, act: Tensor, *, frozen: bool = False) -> Tensor:
        """Both critics, [2, B]."""
        return critic.outputs(pre, act, frozen=frozen, noise=self._noise)[-1][..., 0]

    def _update_critic(self, features: Tensor, pre: Tensor, act: Tensor, q_target: Tensor) -> float:
        """Regress both critics, and by them the encoder."""
        with torch.enable_grad():
            pre = pre.detach().requires_grad_()
            loss = (self._q(self.critic, pre, act) - q_target).square().mean(dim=1).sum()
        grad = self._backward(self.critic, loss, pre, features)
        # Where the features behind the windows were: they are not looked at any more.
        down = product(grad, self.critic.trunk.to(grad.dtype), out=self._then.features)
        self._adams["critic"].step()
        self._now.backward(down)
        self._adams["encoder"].step()
        return loss.item()

    def _update_actor(self, features: Tensor, pre: Tensor, noise: Tensor) -> float:
        """Ascend the smaller Q of the critics as they are now."""
        (pre_critic,) = project(features, self.critic)
        with torch.enable_grad():
            pre = pre.detach().requires_grad_()
            act = self._sample(self.actor.outputs(pre)[-1][0], noise)
            loss = -torch.minimum(*self._q(self.critic, pre_critic, act, frozen=True)).mean()
        self._backward(self.actor, loss, pre, features)
        self._adams["actor"].step()
        return loss.item()

    def _backward(self, tower: Tower, loss: Tensor, pre: Tensor, features: Tensor) -> Tensor:
        """Overwrite the gradient of a tower by a loss of what its trunk made of the features; returns that in `pre`, in
        the precision of the features.
        """
        tower.flat_grad.zero_()
        torch.autograd.backward(loss)
        assert pre.grad is not None
        grad = pre.grad.to(features.dtype)
        if features.dtype == torch.float32:
            product(grad.t(), features, out=tower.trunk_grad)
        else:
            tower.trunk_grad.copy_(product(grad.t(), features))
        return grad

    def reset_critic(self) -> None:
        self.critic.initialise(self._init)
        self.target.flat.copy_(self.critic.flat)
        self._adams["critic"].reset()

    def figures(self) -> dict[str, float]:
        return finite_figures(dict(zip(self.names, self._figures.tolist(), strict=True)), self.updates)

    def weights(self) -> State:
        return {name: net.flat for name, net in self._nets.items()}

    def state_dict(self) -> State:
        return {"updates": self.updates, "step": self._step, **saved(self._tensors, self._adams)}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken; the streams are restored by whoever owns them."""
        restore(self._tensors, self._adams, state)
        self.updates, self._step = state["updates"], state["step"]
