"""Soft actor-critic as B-Pref implements it, the agent under every method of the paper (appendix, SAC table).

Twin critics, a tanh-squashed Gaussian actor and a learned temperature; one update is critic, actor, temperature and,
every second time, the target. The backward pass is written out: only gradients that an optimiser or the actor uses
are computed, in buffers made once. `tests/rrm/agents/reference_sac.py` is the same algorithm in plain autograd, and
the tests hold the two together. Departures from B-Pref: everything is float32 (its temperature is float64), and one
counter decides when the target moves.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rrm.errors import CheckpointError, NumericalError
from rrm.losses import squashed_gaussian_log_prob
from rrm.nets.adam import FlatAdam
from rrm.nets.mlp import Memory, Pass, StackedMLP

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import AgentConfig
    from rrm.envs.tasks import Spaces
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Batch, Floats, Obs, State

_LARGEST = 1 - 1e-6  #: of an action whose density is asked for; float32's tanh rounds to one, where atanh is infinite

tanh_backward = torch.ops.aten.tanh_backward

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0
_HALF_RANGE = 0.5 * (LOG_STD_MAX - LOG_STD_MIN)
_FIGURES = ("critic_loss", "actor_loss", "entropy", "alpha")  #: entropy in nats


def _log_std(squash: Tensor) -> Tensor:
    """From the tanh of the actor's raw output."""
    return squash.add(1).mul_(_HALF_RANGE).add_(LOG_STD_MIN)


class _Sample:
    """Actions drawn from the actor's output, and what their gradient needs. Fields are float32 [A, B]."""

    def __init__(self, head: Tensor, noise: Tensor) -> None:
        """Args: head: the actor's output, [2 A, B]; noise: standard normal, [A, B]."""
        mean, raw = head.chunk(2)
        self.noise = noise
        self.squash = torch.tanh(raw)
        self.log_std = _log_std(self.squash)
        self.spread = self.log_std.exp().mul_(noise)
        self.pre_tanh = mean + self.spread
        self.act = torch.tanh(self.pre_tanh)

    def log_prob(self) -> Tensor:
        """Log density of the actions, float32 [B]."""
        return squashed_gaussian_log_prob(self.noise, self.log_std, self.pre_tanh)

    def backward(self, grad_act: Tensor, grad_log_prob: Tensor, rows: slice) -> Tensor:
        """Gradient in these rows of the actor's output, [2 A, rows], of a loss with these gradients in their actions
        [A, rows] and in their log densities (one number for all).

        With the noise held fixed, d log_prob / d pre_tanh = 2 act (all of it from the log-determinant, the Gaussian's
        part cancels) and d log_prob / d log_std = -1 besides its effect on pre_tanh.
        """
        act, squash = self.act[:, rows], self.squash[:, rows]
        grad_mean = tanh_backward(grad_act, act).addcmul_(grad_log_prob, act, value=2)
        grad_log_std = (grad_mean * self.spread[:, rows]).sub_(grad_log_prob)
        return torch.cat((grad_mean, tanh_backward(grad_log_std, squash).mul_(_HALF_RANGE)))


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
        both = blocks[: 2 * batch]
        self.obs = blocks[:, :obs_dim]
        self.act, self.sampled = taken[:, obs_dim:], both[:, obs_dim:].t()
        self.noise = torch.empty(width - obs_dim, 2 * batch, device=device)
        self.next_rows, self.rows = slice(batch), slice(batch, None)  #: of what was sampled
        memory, shared = Memory.of(actor, 2 * batch), Memory.of(critic, batch)
        self.actor = Pass(actor, both[:, :obs_dim], memory)
        self.ascent = Pass(actor, both[self.rows, :obs_dim], memory.part(self.rows))
        self.target = Pass(target, following, shared)
        self.critic = Pass(critic, taken, shared)
        self.imagined = Pass(critic, imagined, shared, columns=slice(obs_dim, None))


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
        config: AgentConfig,
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
        self._init = streams.torch("init", device)
        self._noise = streams.torch("agent", device)
        self._explore = streams.torch("explore", device)
        self._lookahead = streams.torch("lookahead", device)

        def stack(members: int, inputs: int, outputs: int, generator: torch.Generator | None) -> StackedMLP:
            shape = (members, inputs, config.hidden, config.layers, outputs)
            return StackedMLP(*shape, generator=generator, precision=precision, device=device)

        self.actor = stack(1, obs_dim, 2 * act_dim, self._init)
        self.critic = stack(2, obs_dim + act_dim, 1, self._init)
        self.target = stack(2, obs_dim + act_dim, 1, None)
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
        self._space = _Workspace(self.actor, self.critic, self.target, config.batch)

    @torch.no_grad()
    def act(self, obs: Obs, *, explore: bool) -> Floats:
        head = self._acting(torch.as_tensor(obs.state, dtype=torch.float32))[0]
        if explore:
            noise = torch.randn(self.act_dim, 1, generator=self._explore, device=head.device)
            act = _Sample(head, noise).act
        else:
            act = torch.tanh(head[: self.act_dim])
        action: Floats = act[:, 0].clamp_(-1, 1).cpu().numpy()
        if not np.isfinite(action).all():
            raise NumericalError(
                f"the action after {self.updates} updates is {action.tolist()} for the observation "
                f"{obs.state.tolist()}; look for rewards or observations that are not finite, then for step sizes "
                "that are too large"
            )
        return action

    @torch.no_grad()
    def log_prob(self, obs: Tensor, act: Tensor) -> Tensor:
        mean, raw = self.actor(obs)[0].chunk(2)
        log_std = _log_std(torch.tanh(raw))
        pre_tanh = torch.atanh(act.t().clamp(-_LARGEST, _LARGEST))
        return squashed_gaussian_log_prob((pre_tanh - mean) / log_std.exp(), log_std, pre_tanh)

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One step of critic, actor and temperature; the target follows every second time, the first included."""
        if len(self._space.act) != len(batch.reward):
            self._space = _Workspace(self.actor, self.critic, self.target, len(batch.reward))
        alpha, space = self.log_alpha.exp(), self._space
        torch.cat((batch.next_obs, batch.obs, batch.obs), out=space.obs)
        space.act.copy_(batch.act)
        # One pass samples for the next observations and the present ones: the actor changes only after either was used.
        sample = _Sample(space.actor.forward()[0], space.noise.normal_(generator=self._noise))
        space.sampled.copy_(sample.act)
        log_prob = sample.log_prob()
        critic_loss = self._update_critic(batch, log_prob, alpha)
        actor_loss, entropy = self._update_actor(sample, log_prob, alpha)
        # The loss of the temperature is alpha * (entropy - target), with target -A: its gradient in log alpha, too.
        torch.mul(alpha, entropy + self.act_dim, out=self._log_alpha_grad)
        self._adams["alpha"].step()
        if self.updates % self.config.target_every == 0:
            self.target.flat.lerp_(self.critic.flat, self.config.tau)
        torch.stack((critic_loss, actor_loss, entropy, alpha.squeeze()), out=self._figures)
        self.updates += 1

    def _update_critic(self, batch: Batch, log_prob: Tensor, alpha: Tensor) -> Tensor:
        """Regress both critics on the soft value of the next state; returns the sum of their mean squared errors."""
        space = self._space
        q_next = space.target.forward().squeeze(1)
        value = torch.minimum(q_next[0], q_next[1]).addcmul_(alpha, log_prob[space.next_rows], value=-1)
        q_target = batch.reward.addcmul(batch.continues, value, value=self.config.discount)
        error = space.critic.forward().squeeze(1) - q_target
        torch.mul(error, 2 / len(q_target), out=space.critic.grad.squeeze(1))
        space.critic.backward_params()
        self._adams["critic"].step()
        return error.square().sum() / len(q_target)

    def _update_actor(self, sample: _Sample, log_prob: Tensor, alpha: Tensor) -> tuple[Tensor, Tensor]:
        """Ascend the smaller Q plus entropy; returns the loss and the estimate of the entropy."""
        space = self._space
        q = space.imagined.forward()
        share = -1 / q.shape[-1]
        smaller = q[:1] <= q[1:]
        torch.mul(torch.cat((smaller, ~smaller)), share, out=space.imagined.grad)  # only the smaller critic is asked
        grad_act = space.imagined.backward_inputs()
        space.ascent.grad[0].copy_(sample.backward(grad_act.sum(dim=0), -share * alpha, space.rows))
        space.ascent.backward_params()
        self._adams["actor"].step()
        entropy = -log_prob[space.rows].mean()
        return -alpha.squeeze() * entropy - torch.minimum(q[0], q[1]).mean(), entropy

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
            noise = torch.randn(self.act_dim, len(batch.next_obs), generator=self._lookahead, device=self._noise.device)
            sample = _Sample(self.actor(batch.next_obs)[0], noise)
            q_next = self.target(torch.cat((batch.next_obs, sample.act.t()), dim=-1)).squeeze(1)
            value = torch.minimum(q_next[0], q_next[1]) - self.log_alpha.exp() * sample.log_prob()
        return batch.reward + self.config.discount * batch.continues * value

    def figures(self) -> dict[str, float]:
        figures = dict(zip(_FIGURES, self._figures.tolist(), strict=True))
        if self.updates and not all(map(math.isfinite, figures.values())):
            raise NumericalError(f"a figure of the agent is not finite: {figures}")
        return figures

    def weights(self) -> State:
        return {"actor": self.actor.flat, "critic": self.critic.flat}

    def state_dict(self) -> State:
        return {
            "updates": self.updates,
            "tensors": {name: tensor.clone() for name, tensor in self._tensors.items()},
            "optimisers": {name: adam.state_dict() for name, adam in self._adams.items()},
        }

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken; the streams are restored by whoever owns them."""
        for name, tensor in self._tensors.items():
            saved = state["tensors"][name]
            if saved.shape != tensor.shape:
                raise CheckpointError(
                    f"the saved agent's {name} has shape {tuple(saved.shape)}, this agent's has {tuple(tensor.shape)}; "
                    "load it with the configuration and task it was trained with"
                )
            tensor.copy_(saved)
        for name, adam in self._adams.items():
            adam.load_state_dict(state["optimisers"][name])
        self.updates = state["updates"]
