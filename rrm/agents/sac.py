"""Soft actor-critic as B-Pref implements it, the agent under every method of the paper (appendix, SAC table).

Twin critics, a tanh-squashed Gaussian actor and a learned temperature; one update is critic, actor, temperature and,
every second time, the target. The backward pass is written out: only gradients that an optimiser or the actor uses
are computed, in buffers made once. `tests/rrm/agents/reference_sac.py` is the same algorithm in plain autograd, and
the tests hold the two together. Departures from B-Pref: everything is float32 (its temperature is float64), and one
counter decides when the target moves.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rrm.agents.checks import finite_action, finite_figures, restore, saved
from rrm.losses import squashed_gaussian_log_prob
from rrm.nets.adam import FlatAdam
from rrm.nets.captured import Captured
from rrm.nets.mlp import Memory, Pass, StackedMLP
from rrm.transfers import brought, pinned

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rrm.config import SacConfig
    from rrm.envs.spaces import Spaces
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Batch, Floats, Obs, State

_LARGEST = 1 - 1e-6  #: of an action whose density is asked for; float32's tanh rounds to one, where atanh is infinite

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0
_HALF_RANGE, _MIDDLE = 0.5 * (LOG_STD_MAX - LOG_STD_MIN), 0.5 * (LOG_STD_MAX + LOG_STD_MIN)
_FIGURES = ("critic_loss", "actor_loss", "entropy", "alpha")  #: entropy in nats


def library(of: Tensor) -> tuple[Any, Callable[[Tensor], Any]]:
    """Whose functions small arithmetic beside this tensor uses, and how a tensor is handed to them.

    numpy's calls cost a third of torch's, and know no other device than the processor.
    """
    return (np, Tensor.numpy) if of.device.type == "cpu" else (torch, lambda tensor: tensor)


class _Sample:
    """Actions drawn from an actor's output, and what their gradient needs. Fields are [A, B], of the actor's `library`.

    Args:
        head: the actor's output, [2 A, B].
        act: where the actions go, [A, B]; fresh memory unless given.
    """

    def __init__(self, head: Tensor, act: Tensor | None = None) -> None:
        self.xp, self._view = library(head)
        self.actions = torch.empty_like(head[: len(head) // 2]) if act is None else act
        self._drawn = torch.empty(self.actions.shape, device=head.device)
        self.mean, self.raw = map(self._view, head.chunk(2))
        self.noise, self.act = self._view(self._drawn), self._view(self.actions)

    def draw(self, generator: torch.Generator) -> None:
        """Fresh actions."""
        self._drawn.normal_(generator=generator)
        self.squash = self.xp.tanh(self.raw)
        self.log_std = self.squash * _HALF_RANGE + _MIDDLE
        self.spread = self.xp.exp(self.log_std) * self.noise
        self.pre_tanh = self.mean + self.spread
        self.act[...] = self.xp.tanh(self.pre_tanh)

    def log_prob(self) -> Any:
        """Log density of the actions, [B]."""
        return squashed_gaussian_log_prob(self.noise, self.log_std, self.pre_tanh, self.xp)

    def backward(self, rows: slice, grad_act: Any, grad_log_prob: Any, grad_head: tuple[Any, Any]) -> None:
        """Write the gradient in these rows of the actor's output, both [A, rows], of a loss with these gradients in the
        actions, [A, rows], and in their log densities (one number for all).

        With the noise held fixed, d log_prob / d pre_tanh = 2 act (all of it from the log-determinant, the Gaussian's
        part cancels) and d log_prob / d log_std = -1 besides its effect on pre_tanh.
        """
        act, squash, (grad_mean, grad_raw) = self.act[:, rows], self.squash[:, rows], grad_head
        grad_mean[...] = (1 - act * act) * grad_act + 2 * grad_log_prob * act
        grad_log_std = grad_mean * self.spread[:, rows] - grad_log_prob
        grad_raw[...] = _HALF_RANGE * (1 - squash * squash) * grad_log_std


class _Workspace:
    """Everything that updates with batches of one size write into.

    The inputs of all networks lie in three blocks of rows: next observations with sampled actions, observations with
    sampled actions, observations with the actions taken. The actor reads the observations of the first two at once.
    """

    def __init__(self, actor: StackedMLP, critic: StackedMLP, target: StackedMLP, batch: int) -> None:
        obs_dim, width = actor.widths[0], critic.widths[0]
        device = actor.flat.device
        # Matrix libraries may round differently where memory is aligned differently: inputs are copied to one place,
        # and their rows start on cache lines.
        blocks = torch.empty(3 * batch, -(-width // 16) * 16, device=device)[:, :width]
        following, imagined, taken = torch.split(blocks, batch)
        both, self.batch = blocks[: 2 * batch], batch
        self.obs, self.act = blocks[:, :obs_dim], taken[:, obs_dim:]  #: of all blocks; of the last
        self._given = torch.empty(2, batch, device=device)
        rows, memory, shared = slice(batch, None), Memory(actor, 2 * batch), Memory(critic, batch)
        self.actor = Pass(actor, both[:, :obs_dim], memory)
        self.ascent = Pass(actor, both[rows, :obs_dim], memory.part(rows))
        self.target = Pass(target, following, shared)
        self.critic = Pass(critic, taken, shared)
        self.imagined = Pass(critic, imagined, shared, columns=slice(obs_dim, None))
        self.sample = _Sample(self.actor.outputs[0], both[:, obs_dim:].t())
        # What small arithmetic reads and writes, in numpy's terms with a processor.
        self.xp, self.view = library(blocks)
        self.rows, self.grad_head = rows, tuple(map(self.view, self.ascent.grad[0].chunk(2)))
        self.q_next, self.q_taken, self.q = (
            self.view(there.outputs[:, 0]) for there in (self.target, self.critic, self.imagined)
        )
        self.grad_taken, self.grad_q = self.view(self.critic.grad[:, 0]), self.view(self.imagined.grad[:, 0])
        self.reward, self.continues = map(self.view, self._given)

    def take(self, batch: Batch) -> None:
        """Put a batch where updates read it."""
        torch.cat((batch.next_obs, batch.obs, batch.obs), out=self.obs)
        self.act.copy_(batch.act)
        torch.stack((batch.reward, batch.continues), out=self._given)


class Sac:
    """An `rrm.interfaces.Agent`.

    Args:
        spaces: of observations and actions; frames are not looked at.
        streams: `init` draws weights, `agent` the noise of updates, `explore` the noise of actions taken, `lookahead`
            that of targets somebody else asks for.
        precision: of products between hidden layers (`rrm.nets.precision`).
    """

    def __init__(
        self,
        config: SacConfig,
        spaces: Spaces,
        streams: Streams,
        *,
        precision: Precision = "float32",
        device: str = "cpu",
    ) -> None:
        self.config = config
        self.obs_dim, self.act_dim = obs_dim, act_dim = spaces.obs, spaces.act
        self.critic_lr = config.critic_lr
        self.updates = 0  #: finished updates
        self._init = streams.torch("init")  # the same weights on any device
        self._noise = streams.torch("agent", device)
        self._explore = streams.torch("explore", device)
        self._lookahead = streams.torch("lookahead", device)

        def stack(
            members: int, inputs: int, outputs: int, generator: torch.Generator | None, norm: str = "none"
        ) -> StackedMLP:
            shape = (members, inputs, config.hidden, config.layers, outputs)
            return StackedMLP(
                *shape, generator=generator, precision=precision, normalised=norm == "layer", device=device
            )

        self.actor = stack(1, obs_dim, 2 * act_dim, self._init)
        self.critic = stack(2, obs_dim + act_dim, 1, self._init, config.critic_norm)
        self.target = stack(2, obs_dim + act_dim, 1, None, config.critic_norm)
        self.target.flat.copy_(self.critic.flat)
        self.log_alpha = torch.full((1,), math.log(config.initial_alpha), device=device)
        self._log_alpha_grad = torch.zeros_like(self.log_alpha)
        self._figures = torch.full((4,), math.nan, device=device)  # in the order of _FIGURES
        self._adams = {
            "actor": FlatAdam(self.actor.flat, self.actor.flat_grad, config.actor_lr),
            "critic": FlatAdam(self.critic.flat, self.critic.flat_grad, config.critic_lr),
            "alpha": FlatAdam(self.log_alpha, self._log_alpha_grad, config.alpha_lr),
        }
        self._tensors = {
            "actor": self.actor.flat, "critic": self.critic.flat, "target": self.target.flat,
            "log_alpha": self.log_alpha, "figures": self._figures,
        }  # fmt: skip
        self._acting = Pass(self.actor, torch.empty(1, obs_dim, device=device))
        self._acts = _Sample(self._acting.outputs[0])
        self._seen, self._chosen = pinned(device, 1, obs_dim), pinned(device, act_dim)
        self._acts_by = {
            explore: Captured(partial(self._act, explore), device, generators=[self._explore] if explore else [])
            for explore in (False, True)
        }
        self._device = device
        self._make_room(config.batch)
        self._last: tuple[Any, ...] | None = None  # what the figures of the last update are made of

    def _make_room(self, batch: int) -> None:
        """For updates with so many transitions."""
        self._space = _Workspace(self.actor, self.critic, self.target, batch)
        changed = [tensor for adam in self._adams.values() for tensor in adam.changed]
        self._learning = Captured(self._learn, self._device, changed, [self._noise])

    def at(self, step: int) -> None:
        """Nothing of it depends on the step."""

    @torch.no_grad()
    def act(self, obs: Obs, *, explore: bool) -> Floats:
        self._seen[0] = torch.as_tensor(obs.state, dtype=torch.float32)
        self._acts_by[explore]()
        return finite_action(brought(self._device, self._chosen), self.updates, f"the observation {obs.state.tolist()}")

    def _act(self, explore: bool) -> None:
        """From what is seen to what is chosen."""
        self._acting.given.copy_(self._seen, non_blocking=True)
        self._acting.forward()
        if explore:
            self._acts.draw(self._explore)
        act = self._acts.actions if explore else torch.tanh(self._acting.outputs[0, : self.act_dim])
        self._chosen.copy_(act[:, 0].clamp(-1, 1), non_blocking=True)

    @torch.no_grad()
    def log_prob(self, obs: Tensor, act: Tensor) -> Tensor:
        mean, raw = self.actor(obs)[0].chunk(2)
        log_std = torch.tanh(raw) * _HALF_RANGE + _MIDDLE
        pre_tanh = torch.atanh(act.t().clamp(-_LARGEST, _LARGEST))
        return squashed_gaussian_log_prob((pre_tanh - mean) / log_std.exp(), log_std, pre_tanh)

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One step of critic, actor and temperature; the target follows every second time, the first included."""
        if self._space.batch != len(batch.reward):
            self._make_room(len(batch.reward))
        self._space.take(batch)
        self._last = self._learning()
        if self.updates % self.config.target_every == 0:
            self.target.flat.lerp_(self.critic.flat, self.config.tau)
        self.updates += 1

    def _learn(self) -> tuple[Any, ...]:
        """All of an update but the target's; returns what its figures are made of."""
        space = self._space
        log_alpha, grad = space.view(self.log_alpha), space.view(self._log_alpha_grad)
        alpha = space.xp.exp(log_alpha)
        # One pass samples for the next observations and the present ones: the actor changes only after either was used.
        space.actor.forward()
        space.sample.draw(self._noise)
        log_prob = space.sample.log_prob()
        error = self._update_critic(log_prob[: space.batch], alpha)
        self._update_actor(alpha)
        # The loss of the temperature is alpha * (entropy - target), with target -A: its gradient in log alpha, too.
        entropy = -log_prob[space.rows].mean()
        grad[...] = alpha * (entropy + self.act_dim)
        self._adams["alpha"].step()
        return error, space.q, entropy, alpha

    def _update_critic(self, next_log_prob: Any, alpha: Any) -> Any:
        """Regress both critics on the soft value of the next state; returns their errors, [2, B]."""
        space = self._space
        space.target.forward()
        value = space.xp.minimum(space.q_next[0], space.q_next[1]) - alpha * next_log_prob
        q_target = space.reward + self.config.discount * space.continues * value
        space.critic.forward()
        error = space.q_taken - q_target
        space.grad_taken[...] = error * (2 / space.batch)
        space.critic.backward_params()
        self._adams["critic"].step()
        return error

    def _update_actor(self, alpha: Any) -> None:
        """Ascend the smaller Q plus entropy."""
        space, share = self._space, -1 / self._space.batch
        space.imagined.forward()
        smaller = space.q[0] <= space.q[1]
        space.grad_q[0] = smaller * share  # only the smaller critic is asked
        space.grad_q[1] = ~smaller * share
        grad_act = space.view(space.imagined.backward_inputs()).sum(0)
        space.sample.backward(space.rows, grad_act, -share * alpha, space.grad_head)
        space.ascent.backward_params()
        self._adams["actor"].step()

    def reset_critic(self) -> None:
        self.critic.initialise(self._init)
        self.target.flat.copy_(self.critic.flat)
        self._adams["critic"].reset()

    def q_values(self, obs: Tensor, act: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        return self.critic.plain(torch.cat((obs, act), dim=-1), params).squeeze(1)

    def critic_parameters(self) -> list[Tensor]:
        return self.critic.parameters()

    def q_target(self, batch: Batch) -> Tensor:
        with torch.no_grad():
            sample = _Sample(self.actor(batch.next_obs)[0])
            sample.draw(self._lookahead)
            q_next = self.target(torch.cat((batch.next_obs, sample.actions.t()), dim=-1)).squeeze(1)
            log_prob = torch.as_tensor(sample.log_prob())
            value = torch.minimum(q_next[0], q_next[1]) - self.log_alpha.exp() * log_prob
        return batch.reward + self.config.discount * batch.continues * value

    def figures(self) -> dict[str, float]:
        self._take_figures()
        return finite_figures(dict(zip(_FIGURES, self._figures.tolist(), strict=True)), self.updates)

    def weights(self) -> State:
        return {"actor": self.actor.flat, "critic": self.critic.flat}

    def _take_figures(self) -> None:
        """Of the last update, if they have not been taken yet."""
        if self._last is not None:
            error, q, entropy, alpha = (torch.as_tensor(value) for value in self._last)
            actor_loss = -alpha[0] * entropy - torch.minimum(*q).mean()
            torch.stack((error.square().sum() / error.shape[1], actor_loss, entropy, alpha[0]), out=self._figures)
            self._last = None

    def state_dict(self) -> State:
        self._take_figures()
        return {"updates": self.updates, **saved(self._tensors, self._adams)}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken; the streams are restored by whoever owns them."""
        restore(self._tensors, self._adams, state)
        self._last = None
        self.updates = state["updates"]
