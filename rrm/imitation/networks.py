"""The reward g(s, a) that imitation leaves behind: one network, with a linear head or a bounded one."""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.config import ImitationConfig
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision


class RewardNet:
    """g(s, a): an MLP of state and action (appendix "Imitation rewards": three layers of 256).

    Args:
        config: hidden units, layers and head.
        obs_dim, act_dim: of the task.
        generator: where the weights are drawn from; None leaves them zero, to be loaded.
        precision: of products between hidden layers.
    """

    def __init__(
        self,
        config: ImitationConfig,
        obs_dim: int,
        act_dim: int,
        generator: torch.Generator | None,
        precision: Precision = "float32",
    ) -> None:
        self.net = StackedMLP(
            1, obs_dim + act_dim, config.hidden, config.layers, 1,
            init="torch", generator=generator, precision=precision,
        )  # fmt: skip
        self._bounded = config.head == "tanh"

    def __call__(self, inputs: Tensor) -> Tensor:
        """Rewards [...] of states and actions side by side, [..., O + A]; differentiable in the weights."""
        return self.headed(self.net(inputs.flatten(0, -2)).view(inputs.shape[:-1]))

    def headed(self, raw: Tensor) -> Tensor:
        """The head on the network's outputs."""
        return torch.tanh(raw) if self._bounded else raw

    def backward_head(self, grad: Tensor, headed: Tensor) -> Tensor:
        """The gradient in the network's outputs, given that in the rewards."""
        return grad * (1 - headed.square()) if self._bounded else grad

    @torch.no_grad()
    def predict(self, obs: Tensor, act: Tensor) -> Tensor:
        """Rewards float32 [B] of obs [B, O] and act [B, A]."""
        return self(torch.cat((obs, act), dim=-1))
