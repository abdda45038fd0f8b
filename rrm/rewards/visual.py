"""Rewards learned from preferences over what a camera shows: an ensemble on features, alone or on top of a prior.

    r(s, o, a) = r0(s, a) + tanh(f(features(o), a, r0(s, a)))          (appendix, algorithm 2)

Features are thousands of numbers; each member first makes `agent.features` of them, as the agent's own networks do. No
gradient reaches the encoder: it is the agent's.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import layer_norm

from rrm.config import RewardConfig
from rrm.devices import CPU
from rrm.precision import Precision
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.types import Segments, State


class VisualReward(EnsembleReward):
    """Without a prior (PEBBLE-visual). `obs` of segments and predictions are features, [..., R]."""

    def __init__(
        self,
        config: RewardConfig,
        features: int,
        act_dim: int,
        generator: Generator | None,
        *,
        precision: Precision = "float32",
        device: str = CPU,
        width: int,
    ) -> None:
        """Args: features: of an observation, R; width: numbers that are made of them."""
        super().__init__(config, width, act_dim, generator, precision=precision, device=device)
        drawn = torch.zeros(config.members, features, width)
        if generator is not None:
            bound = 1 / math.sqrt(features)
            drawn.uniform_(-bound, bound, generator=generator)
        self._projection = drawn.to(device).requires_grad_()

    def _inputs(self, segments: Segments) -> Tensor:
        members, features, width = self._projection.shape
        shape = segments.obs.shape[-3:-1]
        if segments.obs.dim() == 3:  # seen by all: one product
            side_by_side = self._projection.transpose(0, 1).reshape(features, -1)
            projected = (segments.obs.flatten(0, 1) @ side_by_side).view(-1, members, width).transpose(0, 1)
        else:
            projected = torch.bmm(segments.obs.flatten(1, 2), self._projection)
        seen = torch.tanh(layer_norm(projected, (width,))).view(members, *shape, width)
        beside = self._beside(segments)
        return torch.cat([seen, beside.expand(members, *shape, beside.shape[-1])], dim=-1)

    def _outputs(self, inputs: Tensor) -> Tensor:
        net = self._net.plain if torch.is_grad_enabled() else self._net
        outputs = net(inputs.flatten(-3, -2)).view(-1, *inputs.shape[-3:-1])
        return outputs if self._linear else torch.tanh(outputs)

    def parameters(self) -> list[Tensor]:
        return [self._projection, *super().parameters()]

    def state_dict(self) -> State:
        return super().state_dict() | {"projection": self._projection.detach().clone()}

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        with torch.no_grad():
            self._projection.copy_(state["projection"])


class VisualResidual(VisualReward, ResidualReward):
    """On top of a prior."""
