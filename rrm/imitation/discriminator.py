"""The discriminator of adversarial inverse reinforcement learning (AIRL, Fu et al. 2018), and its gradient steps.

    f(s, a, s') = g(s, a) + gamma h(s') - h(s)        logit D = f - log pi(a | s)

Cross-entropy with experts as 1 and the policy as 0. h takes up what only shapes the reward, g is what is kept. A time
limit does not end the bootstrap. The gradient is written out: its only path is through the outputs of g and h.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, cast

import torch
from torch import Generator, Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from rrm.config import ImitationConfig
from rrm.devices import CPU
from rrm.errors import NumericalError
from rrm.nets.adam import FlatAdam
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.transfers import to
from rrm.types import Batch, State

if TYPE_CHECKING:
    from rrm.interfaces import Agent, StochasticAgent
    from rrm.nets.encoder import Encoder


class RewardNet:
    """g(s, a), which imitation leaves behind: an MLP with a linear head or a bounded one (appendix).

    Without a generator the weights are zero, to be loaded.
    """

    def __init__(
        self,
        config: ImitationConfig,
        obs_dim: int,
        act_dim: int,
        generator: Generator | None,
        *,
        precision: Precision = "float32",
        device: str = CPU,
    ) -> None:
        self.net = StackedMLP(
            1, obs_dim + act_dim, config.hidden, config.layers, 1,
            init="torch", generator=generator, precision=precision, device=device,
        )  # fmt: skip
        self.bounded = config.head == "tanh"

    def __call__(self, inputs: Tensor) -> Tensor:
        """Rewards [...] of states and actions side by side, [..., O + A]; differentiable in the weights."""
        return self.headed(self.net(inputs.flatten(0, -2)).view(inputs.shape[:-1]))

    def headed(self, raw: Tensor) -> Tensor:
        """The head on the network's outputs."""
        return torch.tanh(raw) if self.bounded else raw

    @torch.no_grad()
    def predict(self, obs: Tensor, act: Tensor) -> Tensor:
        """Rewards float32 [B] of obs [B, O] and act [B, A]."""
        return self(torch.cat((obs, act), dim=-1))


def joined(expert: Batch, policy: Batch) -> Batch:
    """Transitions of both, the expert's first."""
    pairs = zip(expert, policy, strict=True)
    return Batch(*(None if e is None or p is None else torch.cat((e, p)) for e, p in pairs))  # type: ignore[arg-type]


def on_device(device: str, batch: Batch) -> Batch:
    """The batch on a device."""
    return Batch(*(field if field is None else to(device, field) for field in batch))  # type: ignore[arg-type]


def experts_first(both: Batch) -> Tensor:
    """What a discriminator is to say of what `joined` made: 1 of the expert's half, 0 of the policy's, [2 B]."""
    count = len(both.act)
    return (torch.arange(count, device=both.act.device) < count // 2).float()


class Discriminator:
    """Reward g and shaping h with one optimiser step for both; what g is trained on is `config.pretrain`."""

    most, at_once = sys.maxsize, 2048  #: transitions by which g is judged, and of which that is asked together

    def __init__(
        self,
        config: ImitationConfig,
        obs_dim: int,
        act_dim: int,
        discount: float,
        *,
        generator: Generator,
        precision: Precision = "float32",
        device: str = CPU,
    ) -> None:
        self.config = config
        self.discount = discount
        self.device = device
        self.g = RewardNet(config, obs_dim, act_dim, generator, precision=precision, device=device)
        self.h = StackedMLP(
            1, obs_dim, config.hidden, config.layers, 1,
            init="torch", generator=generator, precision=precision, device=device,
        )  # fmt: skip
        self._sizes = {"obs_dim": obs_dim, "act_dim": act_dim}
        self.nets: dict[str, StackedMLP | Encoder] = {}
        self._adams: dict[str, FlatAdam] = {}
        self._add(g=self.g.net, h=self.h)

    def _add(self, **nets: StackedMLP | Encoder) -> None:
        """Train and save these, too."""
        self.nets |= nets
        self._adams |= {name: FlatAdam(net.flat, net.flat_grad, self.config.lr) for name, net in nets.items()}

    def density(self, agent: Agent, batch: Batch) -> Tensor:
        """Log density of what was done in a batch under the agent's policy, without gradient: float32 [B], nats."""
        return cast("StochasticAgent", agent).log_prob(batch.obs, batch.act)

    def reward(self, batch: Batch) -> Tensor:
        """What g says of transitions, float32 [B], without gradient."""
        return self.g.predict(batch.obs, batch.act)

    @torch.no_grad()
    def f(self, batch: Batch) -> Tensor:
        """The shaped reward of transitions, float32 [B]."""
        h, h_next = self.h(torch.cat((batch.obs, batch.next_obs)))[0, 0].chunk(2)
        return self.g.predict(batch.obs, batch.act) + self.discount * batch.continues * h_next - h

    @torch.no_grad()
    def step(self, both: Batch, log_prob: Tensor) -> float:
        """One gradient step; returns the norm of g's gradient.

        Args:
            both: as many transitions of the expert and then of the policy, [2 B].
            log_prob: of their actions, under the policy as it is, nats [2 B].
        """
        g, h, count = self.g.net, self.h, len(both.obs)
        is_expert = experts_first(both)
        pairs_in = torch.cat((both.obs, both.act), dim=1)
        here = g.take(pairs_in.shape)
        reward = self.g.headed(here(pairs_in)[0, 0])
        if self.config.pretrain == "airl":
            states = torch.cat((both.obs, both.next_obs))
            there = h.take(states.shape)
            value, value_next = there(states)[0, 0].chunk(2)
            bootstrap = self.discount * both.continues
            logit = reward + bootstrap * value_next - value - log_prob
            delta = (torch.sigmoid(logit) - is_expert) / count
            loss = binary_cross_entropy_with_logits(logit, is_expert)
            torch.cat((-delta, bootstrap * delta), out=there.grad[0, 0])
            there.backward_params()
            h.give_back(there)
            trained = ["g", "h"]
        else:  # g alone, pulled to 1 on expert transitions and to 0 on the policy's (the paper's figure on fine-tuning)
            error = reward - is_expert
            delta, loss = error * (2 / count), error.square().mean()
            trained = ["g"]
        if self.g.bounded:  # the gradient in the network's outputs, given that in the rewards
            delta = delta * (1 - reward.square())
        here.grad[0, 0].copy_(delta)
        here.backward_params()
        g.give_back(here)
        self._descend(loss, trained)
        return float(g.flat_grad.norm())

    def _descend(self, loss: Tensor, nets: Iterable[str]) -> None:
        """Step along the gradients of a loss, which must be finite, in these nets."""
        if not torch.isfinite(loss):
            raise NumericalError(f"the loss of the discriminator is {float(loss)}")
        for name in nets:
            self._adams[name].step()

    def described(self) -> State:
        """What a prior is made of beside its weights."""
        return {"shape": {name: getattr(self.config, name) for name in ("hidden", "layers", "head")}, **self._sizes}

    def kept(self) -> State:
        """The weights of a prior: all but h."""
        return {name: net.flat.clone() for name, net in self.nets.items() if name != "h"}

    def state_dict(self) -> State:
        optimisers = [adam.state_dict() for adam in self._adams.values()]
        return {name: net.flat.clone() for name, net in self.nets.items()} | {"optimisers": optimisers}

    def load_state_dict(self, state: State) -> None:
        for name, net in self.nets.items():
            net.flat.copy_(state[name])
        for adam, saved in zip(self._adams.values(), state["optimisers"], strict=True):
            adam.load_state_dict(saved)
