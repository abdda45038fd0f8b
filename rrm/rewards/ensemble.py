"""A reward learned from nothing but preferences: an ensemble of networks of (s, a), each bounded by tanh (PEBBLE)."""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.config import RewardConfig
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.types import Segments, State


class Ensemble:
    """N independent networks with outputs in (-1, 1), or with linear ones (appendix "Model structure")."""

    def __init__(
        self,
        config: RewardConfig,
        inputs: int,
        generator: torch.Generator,
        precision: Precision = "float32",
        *,
        linear: bool = False,
    ) -> None:
        self._linear = linear
        self.net = StackedMLP(
            config.members, inputs, config.hidden, config.layers, 1,
            activation="leaky_relu", init="torch", generator=generator, precision=precision,
        )  # fmt: skip

    def __call__(self, x: Tensor) -> Tensor:
        """Outputs [N, B, T] for inputs [B, T, D] shared by the members, or [N, B, T, D] of their own."""
        shape = x.shape[-3:-1]
        outputs = self.net(x.flatten(-3, -2))
        return (outputs if self._linear else torch.tanh(outputs)).view(-1, *shape)


class EnsembleReward:
    """r(s, a) by every member; the prior is not looked at."""

    extra_inputs = 0  #: beside state and action

    def __init__(
        self,
        config: RewardConfig,
        obs_dim: int,
        act_dim: int,
        generator: torch.Generator,
        precision: Precision = "float32",
    ) -> None:
        self._config = config
        inputs = obs_dim + act_dim + self.extra_inputs
        self._ensemble = Ensemble(config, inputs, generator, precision, linear=self._linear)

    @property
    def _linear(self) -> bool:
        """Whether nothing bounds what the networks say."""
        return False

    def members(self, segments: Segments) -> Tensor:
        return self._ensemble(torch.cat([segments.obs, segments.act], dim=-1))

    @torch.no_grad()
    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:
        steps = Segments(obs.unsqueeze(0), act.unsqueeze(0), prior.unsqueeze(0))
        return self.members(steps).mean(dim=0).squeeze(0)

    def penalty(self, rewards: Tensor, segments: Segments) -> Tensor:  # noqa: ARG002 (the seam other rewards use)
        """The tanh is bound enough."""
        return rewards.new_zeros(())

    def parameters(self) -> list[Tensor]:
        return self._ensemble.net.parameters()

    def state_dict(self) -> State:
        return {"weights": self._ensemble.net.flat.clone()}

    def load_state_dict(self, state: State) -> None:
        self._ensemble.net.flat.copy_(state["weights"])
