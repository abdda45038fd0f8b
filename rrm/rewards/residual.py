"""The residual reward model: a prior known beforehand plus what preferences add to it (section 3, equation 3).

    r(s, a) = r0(s, a) + tanh(f(s, a, r0(s, a)))

The prior value is also an input of the network, so that the residual can cancel a prior it finds misleading. Whoever
trains or queries the reward sees the sum; nothing else in the library knows that there are two parts.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.config import RewardConfig
from rrm.rewards.ensemble import BoundedEnsemble, mean_reward
from rrm.types import Segments, State


class ResidualReward:
    """Prior plus bounded residual, by every member of an ensemble."""

    def __init__(self, config: RewardConfig, obs_dim: int, act_dim: int, generator: torch.Generator) -> None:
        self._residual = BoundedEnsemble(config, obs_dim + act_dim + 1, generator)

    def members(self, segments: Segments) -> Tensor:
        prior = segments.prior
        residual = self._residual(torch.cat([segments.obs, segments.act, prior.unsqueeze(-1)], dim=-1))
        return prior + residual

    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:
        return mean_reward(self, obs, act, prior)

    def parameters(self) -> list[Tensor]:
        return self._residual.net.parameters()

    def state_dict(self) -> State:
        return {"weights": self._residual.net.flat.clone()}

    def load_state_dict(self, state: State) -> None:
        self._residual.net.flat.copy_(state["weights"])
