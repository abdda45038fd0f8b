"""DrQ-v2 (Yarats et al. 2021): a deterministic actor and twin critics on the features of a convolutional encoder.

An update moves the pictures at random, regresses the critics on n-step returns and with them trains the encoder, then
ascends the smaller critic by the actor, on the features as they were; the target of the critics follows. The way
through encoder and trunks is written out; `tests/rrm/agents/reference_drqv2.py` is the same algorithm in plain
autograd, and the tests hold the two together. The agent sees frames and nothing else.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import torch
from torch import Tensor

from rrm.agents.checks import finite_action, finite_figures, restore, saved
from rrm.devices import CPU, kind_of
from rrm.nets.adam import FlatAdam
from rrm.nets.captured import Captured
from rrm.nets.encoder import Encoder, Pass
from rrm.nets.tower import Tower, product, project
from rrm.transfers import brought, pinned, to

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import DrqConfig
    from rrm.envs.spaces import Spaces
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Batch, Floats, Obs, State

_LARGEST = 1 - 1e-6  #: of an action


class _Given(NamedTuple):
    """What an update learns from: windows of `n_step` steps."""

    frames: Tensor  #: uint8 [B, stack + n_step, channels, height, width]
    act: Tensor  #: first actions, [B, A]
    rewards: Tensor  #: [B, n_step]
    continues: Tensor  #: [B, n_step]
    moves: Tensor  #: of the first stack of a window and of the last, int64 [2, B, 2]


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
        self._stack, self._device = spaces.frames.stack, device
        self._step = torch.zeros((), dtype=torch.float64, device=device)  # the present one, of the environment
        self._init = streams.torch("init")  # the same weights on any device
        self._noise = streams.torch("agent", device)
        self._explore = streams.torch("explore", device)
        self._shift = streams.numpy("shift")
        self.encoder = Encoder(config, spaces.frames, self._init, precision, device)
        self.actor = self._tower(1, outputs=spaces.act)
        self.critic = self._tower(2, extra=spaces.act, dropout=self._dropout)
        self.target = self._tower(2, extra=spaces.act, dropout=self._dropout, fresh=False)
        self.target.flat.copy_(self.critic.flat)
        self._figures = torch.full((len(self.names),), math.nan, device=device)
        self._last: Sequence[Tensor] | None = None  # what the figures of the last update are made of
        self._nets: dict[str, Encoder | Tower] = {}
        self._adams: dict[str, FlatAdam] = {}
        for name, net in (("encoder", self.encoder), ("actor", self.actor), ("critic", self.critic)):
            self._train(name, net)
        self._seen = pinned(device, 1, self._stack, *spaces.frames.planar, dtype=torch.uint8)
        self._near = torch.empty_like(self._seen, device=device) if kind_of(device) != CPU else self._seen
        self._chosen = pinned(device, spaces.act)
        self._acting = Pass(self.encoder, 1, back=False)
        self._acts_by = {
            explore: Captured(partial(self._act, explore), device, generators=[self._explore] if explore else [])
            for explore in (False, True)
        }
        self._rows = 0  # of the batches that there are places for

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
        self._rows = rows
        self._now, self._then = Pass(self.encoder, rows), Pass(self.encoder, rows, back=False)
        self._given: _Given | None = None
        self._learning = Captured(self._learn, self._device, self._changed, [self._noise])

    @property
    def _tensors(self) -> dict[str, Tensor]:
        nets = {name: net.flat for name, net in self._nets.items()}
        return nets | {"target": self.target.flat, "figures": self._figures}

    def at(self, step: int) -> None:
        self._step.fill_(step)

    @property
    def stddev(self) -> float:
        """Of the noise of actions, at the present step."""
        return self._deviation().item()

    def _deviation(self) -> Tensor:
        """The same where the networks are, a scalar in double precision."""
        return self._scheduled(self._step)

    def _scheduled(self, step: Tensor) -> Tensor:
        config = self.config
        share = (step / config.stddev_steps).clamp(0, 1)
        return (1 - share) * config.stddev + share * config.last_stddev

    @torch.no_grad()
    def act(self, obs: Obs, *, explore: bool) -> Floats:
        self._seen.numpy()[0] = obs.frames
        self._acts_by[explore]()
        return finite_action(brought(self._device, self._chosen), self.updates, "the frames of this step")

    def _act(self, explore: bool) -> None:
        """From what is seen to what is chosen."""
        if self._near is not self._seen:
            self._near.copy_(self._seen, non_blocking=True)
        mean = self._mean(self._acting.forward(self._near))[0]
        if explore:
            noise = torch.empty_like(mean).normal_(generator=self._explore)
            mean = (mean + self._deviation().float() * noise).clamp(-_LARGEST, _LARGEST)
        self._chosen.copy_(mean, non_blocking=True)

    def _mean(self, features: Tensor) -> Tensor:
        (pre,) = project(features.float(), self.actor)
        return torch.tanh(self.actor.outputs(pre, frozen=True)[-1][0])

    @torch.no_grad()
    def log_prob(self, frames: Tensor, act: Tensor) -> Tensor:
        """Log density of any actions [B, A] at frames [B, stack, channels, height, width], [B]: that of the noise at
        the present standard deviation around the deterministic action, whatever of it lies beyond the bounds.
        """
        stddev = max(self.stddev, 1e-6)
        noise = (act - self._mean(self.encoder.encode(frames))) / stddev
        return (-0.5 * noise.square() - math.log(stddev * math.sqrt(2 * math.pi))).sum(dim=1)

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One step of critics, encoder and actor; the target follows."""
        if len(batch.reward) != self._rows:
            self._passes(len(batch.reward))
        self._take(batch)
        self._last = self._learning()
        self.updates += 1

    def _take(self, batch: Batch) -> None:
        """Have the update read this batch; on a card it is put where the last one was."""
        assert batch.frames is not None
        reach = self.config.shift
        moves = torch.from_numpy(self._shift.integers(-reach, reach + 1, (2, len(batch.reward), 2)))
        given = _Given(batch.frames, batch.act[:, 0], batch.reward, batch.continues, to(self._device, moves))
        if kind_of(self._device) == CPU:
            self._given = given
            return
        if self._given is None:
            self._given = _Given(*map(torch.empty_like, given))
        for place, part in zip(self._given, given, strict=True):
            place.copy_(part)

    def _learn(self) -> Sequence[Tensor]:
        """All of an update; returns its figures, in the order of `names`."""
        assert self._given is not None
        frames, act, rewards, continues, moves = self._given
        noise, noise_next = torch.empty(2, *act.shape, device=self._device).normal_(generator=self._noise)
        features = self._now.forward(frames[:, : self._stack], moves[0])
        following = self._then.forward(frames[:, rewards.shape[1] :], moves[1])

        pre_actor, pre_critic = self._look(features, act)
        reward, discount = self._returns(rewards, continues)
        q_target = reward + discount * self._value(following, noise_next)
        critic_loss = self._update_critic(features, pre_critic, act, q_target)
        actor_loss = self._update_actor(features, pre_actor, noise)
        self.target.flat.lerp_(self.critic.flat, self.config.tau)
        return critic_loss, actor_loss, self._deviation()

    @property
    def _changed(self) -> list[Tensor]:
        """What an update reads and then changes."""
        return [self.target.flat, *(tensor for adam in self._adams.values() for tensor in adam.changed)]

    def _returns(self, rewards: Tensor, continues: Tensor) -> tuple[Tensor, Tensor]:
        """Discounted sum of the rewards of a window up to a termination, and what a value behind it counts, [B]."""
        discount = (self.config.discount * continues).cumprod(dim=1)
        before = torch.cat((torch.ones_like(discount[:, :1]), discount[:, :-1]), dim=1)
        return (before * rewards).sum(dim=1), discount[:, -1]

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
        act = torch.tanh(raw) + (self._deviation().float() * noise).clamp(-clip, clip)
        return act + (act.clamp(-_LARGEST, _LARGEST) - act).detach()

    def _q(self, critic: Tower, pre: Tensor, act: Tensor, *, frozen: bool = False) -> Tensor:
        """Both critics, [2, B]."""
        return critic.outputs(pre, act, frozen=frozen, noise=self._noise)[-1][..., 0]

    def _update_critic(self, features: Tensor, pre: Tensor, act: Tensor, q_target: Tensor) -> Tensor:
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
        return loss.detach()

    def _update_actor(self, features: Tensor, pre: Tensor, noise: Tensor) -> Tensor:
        """Ascend the smaller Q of the critics as they are now."""
        (pre_critic,) = project(features, self.critic)
        with torch.enable_grad():
            pre = pre.detach().requires_grad_()
            act = self._sample(self.actor.outputs(pre)[-1][0], noise)
            loss = -torch.minimum(*self._q(self.critic, pre_critic, act, frozen=True)).mean()
        self._backward(self.actor, loss, pre, features)
        self._adams["actor"].step()
        return loss.detach()

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
        self._take_figures()
        return finite_figures(dict(zip(self.names, self._figures.tolist(), strict=True)), self.updates)

    def _take_figures(self) -> None:
        """Of the last update, if they have not been taken yet."""
        if self._last is not None:
            torch.stack([figure.float() for figure in self._last], out=self._figures)
            self._last = None

    def weights(self) -> State:
        return {name: net.flat for name, net in self._nets.items()}

    def state_dict(self) -> State:
        self._take_figures()
        return {"updates": self.updates, "step": int(self._step), **saved(self._tensors, self._adams)}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken; the streams are restored by whoever owns them."""
        restore(self._tensors, self._adams, state)
        self._last = None
        self.updates = state["updates"]
        self.at(state["step"])
