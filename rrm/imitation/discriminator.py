"""The discriminator of adversarial inverse reinforcement learning (AIRL, Fu et al. 2018), and its gradient steps.

    f(s, a, s') = g(s, a) + gamma h(s') - h(s)        logit D = f - log pi(a | s)

Cross-entropy with experts as 1 and the policy as 0. h takes up what only shapes the reward, g is what is kept. A time
limit does not end the bootstrap. The gradient is written out: its only path is through the outputs of g and h.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from rrm.config import ImitationConfig
from rrm.errors import NumericalError
from rrm.nets.adam import FlatAdam
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.types import Batch, State


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
        precision: Precision = "float32",
    ) -> None:
        self.net = StackedMLP(
            1, obs_dim + act_dim, config.hidden, config.layers, 1,
            init="torch", generator=generator, precision=precision,
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


class Discriminator:
    """Reward g and shaping h with one optimiser step for both; what g is trained on is `config.pretrain`."""

    def __init__(
        self,
        config: ImitationConfig,
        obs_dim: int,
        act_dim: int,
        discount: float,
        *,
        generator: Generator,
        precision: Precision = "float32",
    ) -> None:
        self.config = config
        self.discount = discount
        self.g = RewardNet(config, obs_dim, act_dim, generator, precision)
        self.h = StackedMLP(
            1, obs_dim, config.hidden, config.layers, 1, init="torch", generator=generator, precision=precision
        )
        self._adams = tuple(FlatAdam(net.flat, net.flat_grad, config.lr) for net in (self.g.net, self.h))

    @torch.no_grad()
    def f(self, batch: Batch) -> Tensor:
        """The shaped reward of transitions, float32 [B]."""
        h, h_next = self.h(torch.cat((batch.obs, batch.next_obs)))[0, 0].chunk(2)
        return self.g.predict(batch.obs, batch.act) + self.discount * batch.continues * h_next - h

    @torch.no_grad()
    def step(self, expert: Batch, policy: Batch, log_prob: Tensor) -> float:
        """One gradient step on as many expert transitions as policy transitions; returns the norm of g's gradient.

        Args:
            log_prob: of the expert's actions and then the policy's, under the policy as it is, nats [2 B].
        """
        pairs = [(e, p) for e, p in zip(expert, policy, strict=True) if e is not None and p is not None]
        both = Batch(*(torch.cat(pair) for pair in pairs))
        is_expert = torch.zeros(len(both.obs)).index_fill_(0, torch.arange(len(expert.obs)), 1.0)
        g, h, count = self.g.net, self.h, len(both.obs)
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
            self._adams[1].step()
            h.give_back(there)
        else:  # g alone, pulled to 1 on expert transitions and to 0 on the policy's (the paper's figure on fine-tuning)
            error = reward - is_expert
            delta, loss = error * (2 / count), error.square().mean()
        if self.g.bounded:  # the gradient in the network's outputs, given that in the rewards
            delta = delta * (1 - reward.square())
        here.grad[0, 0].copy_(delta)
        here.backward_params()
        self._adams[0].step()
        g.give_back(here)
        if not torch.isfinite(loss):
            raise NumericalError(f"the loss of the discriminator is {float(loss)}")
        return float(g.flat_grad.norm())

    def state_dict(self) -> State:
        optimisers = [adam.state_dict() for adam in self._adams]
        return {"g": self.g.net.flat.clone(), "h": self.h.flat.clone(), "optimisers": optimisers}

    def load_state_dict(self, state: State) -> None:
        self.g.net.flat.copy_(state["g"])
        self.h.flat.copy_(state["h"])
        for adam, saved in zip(self._adams, state["optimisers"], strict=True):
            adam.load_state_dict(saved)
