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
from rrm.nets.mlp import StackedMLP

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import AgentConfig
    from rrm.interfaces import Floats
    from rrm.seeding import Streams
    from rrm.types import Batch, State

LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0
_HALF_RANGE = 0.5 * (LOG_STD_MAX - LOG_STD_MIN)
_FIGURES = ("critic_loss", "actor_loss", "entropy", "alpha")


class _Sample:
    """Actions drawn from the actor's output, and what their gradient needs. Fields are float32 [B, A]."""

    def __init__(self, head: Tensor, noise: Tensor) -> None:
        mean, raw = head.chunk(2, dim=-1)
        self.squash = torch.tanh(raw)
        self.noise = noise
        self.log_std = LOG_STD_MIN + _HALF_RANGE * (self.squash + 1)
        self.spread = self.log_std.exp() * noise
        self.pre_tanh = mean + self.spread
        self.act = torch.tanh(self.pre_tanh)

    def log_prob(self) -> Tensor:
        """Log density of the actions, float32 [B]."""
        return squashed_gaussian_log_prob(self.noise, self.log_std, self.pre_tanh)

    def backward(self, grad_act: Tensor, grad_log_prob: Tensor) -> Tensor:
        """Gradient in the actor's output, [B, 2 A], of a loss with these gradients in the action and its log density.

        With the noise held fixed, d log_prob / d pre_tanh = 2 act (all of it from the log-determinant, the Gaussian's
        part cancels) and d log_prob / d log_std = -1 besides its effect on pre_tanh.
        """
        grad_mean = grad_act * (1 - self.act.square()) + 2 * grad_log_prob * self.act
        grad_log_std = grad_mean * self.spread - grad_log_prob
        return torch.cat((grad_mean, _HALF_RANGE * grad_log_std * (1 - self.squash.square())), dim=-1)


class _Workspace:
    """Everything that updates with batches of one size write into."""

    def __init__(self, actor: StackedMLP, critic: StackedMLP, batch: int) -> None:
        device = actor.flat.device
        self.actor = actor.tape(batch)
        self.critic = critic.tape(batch)
        self.noise = torch.empty(batch, actor.widths[-1] // 2, device=device)
        # Matrix libraries may round differently where memory is aligned differently: inputs are copied to one place.
        self.obs = torch.empty(batch, actor.widths[0], device=device)
        self._obs_act = torch.empty(batch, critic.widths[0], device=device)

    def join(self, obs: Tensor, act: Tensor) -> Tensor:
        """The critic's input [B, O + A], valid until the next call."""
        return torch.cat((obs, act), dim=-1, out=self._obs_act)


class Sac:
    """An `rrm.interfaces.Agent`.

    Args:
        config: sizes, step sizes, discount and target rate.
        obs_dim, act_dim: features of an observation, dimensions of an action.
        streams: `init` draws weights, `agent` the noise of updates, `explore` the noise of actions taken.
        device: where everything is computed.
    """

    def __init__(self, config: AgentConfig, obs_dim: int, act_dim: int, streams: Streams, device: str = "cpu") -> None:
        self.config = config
        self.obs_dim, self.act_dim = obs_dim, act_dim
        self.updates = 0  #: finished updates
        self._init = streams.torch("init", device)
        self._noise = streams.torch("agent", device)
        self._explore = streams.torch("explore", device)
        sizes = (config.hidden, config.layers)
        self.actor = StackedMLP(1, obs_dim, *sizes, 2 * act_dim, generator=self._init, device=device)
        self.critic = StackedMLP(2, obs_dim + act_dim, *sizes, 1, generator=self._init, device=device)
        self.target = StackedMLP(2, obs_dim + act_dim, *sizes, 1, generator=None, device=device)
        self.target.flat.copy_(self.critic.flat)
        self.log_alpha = torch.full((1,), math.log(config.initial_alpha), device=device)
        self._log_alpha_grad = torch.zeros_like(self.log_alpha)
        self._actor_adam = FlatAdam(self.actor.flat, self.actor.flat_grad, config.actor_lr)
        self._critic_adam = FlatAdam(self.critic.flat, self.critic.flat_grad, config.critic_lr)
        self._alpha_adam = FlatAdam(self.log_alpha, self._log_alpha_grad, config.alpha_lr)
        self._figures = torch.full((4,), math.nan, device=device)  #: in the order of _FIGURES
        self._acting = self.actor.tape(1)
        self._space = _Workspace(self.actor, self.critic, config.batch)

    @torch.no_grad()
    def act(self, obs: Floats, *, explore: bool) -> Floats:
        """Action float32 [A] in [-1, 1] for one observation float32 [O].

        Raises:
            NumericalError: the action is not finite, because the observation is not or because training diverged.
        """
        row = torch.tensor(obs, dtype=torch.float32, device=self.actor.flat.device).unsqueeze(0)
        head = self.actor.forward(row, self._acting)[0]
        if explore:
            noise = torch.randn(1, self.act_dim, generator=self._explore, device=head.device)
            act = _Sample(head, noise).act
        else:
            act = torch.tanh(head[:, : self.act_dim])
        action: Floats = act[0].clamp_(-1, 1).cpu().numpy()
        if not np.isfinite(action).all():
            raise NumericalError(
                f"the action after {self.updates} updates is {action.tolist()} for the observation {obs.tolist()}; "
                "look for rewards or observations that are not finite, then for step sizes that are too large"
            )
        return action

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One step of critic, actor and temperature; the target follows every second time, the first included."""
        if len(self._space.obs) != len(batch.reward):
            self._space = _Workspace(self.actor, self.critic, len(batch.reward))
        alpha = self.log_alpha.exp()
        critic_loss = self._update_critic(batch, alpha)
        actor_loss, entropy = self._update_actor(batch, alpha)
        self._update_alpha(entropy, alpha)
        if self.updates % self.config.target_every == 0:
            self.target.flat.lerp_(self.critic.flat, self.config.tau)
        torch.stack((critic_loss, actor_loss, entropy, alpha.squeeze()), out=self._figures)
        self.updates += 1

    def _sample(self, obs: Tensor) -> _Sample:
        head = self.actor.forward(self._space.obs.copy_(obs), self._space.actor)[0]
        return _Sample(head, self._space.noise.normal_(generator=self._noise))

    def _update_critic(self, batch: Batch, alpha: Tensor) -> Tensor:
        """Regress both critics on the soft value of the next state; returns the sum of their mean squared errors."""
        space = self._space
        following = self._sample(batch.next_obs)
        q_next = self.target.forward(space.join(batch.next_obs, following.act), space.critic).squeeze(-1)
        value = torch.minimum(q_next[0], q_next[1]) - alpha * following.log_prob()
        q_target = batch.reward + self.config.discount * batch.continues * value
        q = self.critic.forward(space.join(batch.obs, batch.act), space.critic).squeeze(-1)
        error = q - q_target
        self.critic.backward_params((error * (2 / len(q_target))).unsqueeze(-1), space.critic)
        self._critic_adam.step()
        return error.square().sum() / len(q_target)

    def _update_actor(self, batch: Batch, alpha: Tensor) -> tuple[Tensor, Tensor]:
        """Ascend the smaller Q plus entropy; returns the loss and the estimate of the entropy."""
        space = self._space
        sample = self._sample(batch.obs)
        q = self.critic.forward(space.join(batch.obs, sample.act), space.critic)
        share = -1 / q.shape[1]
        grad_q = torch.stack((q[0] <= q[1], q[0] > q[1])) * share  # only the smaller critic is asked
        grad_act = self.critic.backward_inputs(grad_q, space.critic, slice(self.obs_dim, None))
        grad_head = sample.backward(grad_act.sum(dim=0), -share * alpha)
        self.actor.backward_params(grad_head.unsqueeze(0), space.actor)
        self._actor_adam.step()
        entropy = -sample.log_prob().mean()
        return -alpha.squeeze() * entropy - torch.minimum(q[0], q[1]).mean(), entropy

    def _update_alpha(self, entropy: Tensor, alpha: Tensor) -> None:
        """The loss alpha * (entropy - target entropy), with target -A; its gradient in log alpha equals the loss."""
        torch.mul(alpha, entropy + self.act_dim, out=self._log_alpha_grad)
        self._alpha_adam.step()

    def reset_critic(self) -> None:
        """Fresh critic, target and critic optimiser; actor and temperature stay (PEBBLE's first session)."""
        self.critic.initialise(self._init)
        self.target.flat.copy_(self.critic.flat)
        self._critic_adam.reset()

    def q_values(self, obs: Tensor, act: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """What both critics say of obs [B, O] and act [B, A], float32 [2, B], differentiable.

        Args:
            obs, act: observations and actions.
            params: in place of `critic.parameters()`, for learners that look one step of the critic ahead.
        """
        return self.critic(torch.cat((obs, act), dim=-1), params).squeeze(-1)

    def metrics(self) -> dict[str, float]:
        """`critic_loss`, `actor_loss`, `entropy` (nats) and `alpha` of the last update; NaN before the first."""
        return dict(zip(_FIGURES, self._figures.tolist(), strict=True))

    def state_dict(self) -> State:
        """Networks, optimisers, temperature, target, counter and the figures of the last update."""
        return {
            "updates": self.updates,
            "tensors": {name: tensor.clone() for name, tensor in self._tensors().items()},
            "optimisers": {name: adam.state_dict() for name, adam in self._optimisers().items()},
        }

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken; the streams are restored by whoever owns them.

        Raises:
            CheckpointError: the state is of an agent with other sizes.
        """
        for name, tensor in self._tensors().items():
            saved = state["tensors"][name]
            if saved.shape != tensor.shape:
                raise CheckpointError(
                    f"the saved agent's {name} has shape {tuple(saved.shape)}, this agent's has {tuple(tensor.shape)}; "
                    "load it with the configuration and task it was trained with"
                )
            tensor.copy_(saved)
        for name, adam in self._optimisers().items():
            adam.load_state_dict(state["optimisers"][name])
        self.updates = state["updates"]

    def _tensors(self) -> dict[str, Tensor]:
        return {
            "actor": self.actor.flat,
            "critic": self.critic.flat,
            "target": self.target.flat,
            "log_alpha": self.log_alpha,
            "figures": self._figures,
        }

    def _optimisers(self) -> dict[str, FlatAdam]:
        return {"actor": self._actor_adam, "critic": self._critic_adam, "alpha": self._alpha_adam}
