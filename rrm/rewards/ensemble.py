"""Rewards learned by an ensemble of networks, alone (PEBBLE's) or on top of a prior: the residual reward model.

    r(s, a) = r0(s, a) + tanh(f(s, a, r0(s, a)))          (section 3, equation 3)

The prior value is also an input of the network, so that the residual can cancel a prior it finds misleading. Whoever
trains or queries the reward sees the sum; nothing else in the library knows that there are two parts.

The tanh stands for a prior belief N(r; r0, sigma^2) about the reward (appendix "Motivating RRMs with MAP estimation").
With `reward.bound = "gaussian"` the residual is f itself, and what that belief adds to the loss is its penalty:
lambda f^2, in the mean over all steps of both segments. A reward without a prior has no r0 to be near: it keeps its
tanh, as PEBBLE's does, and `bound` means nothing to it.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from rrm.config import RewardConfig
from rrm.devices import CPU
from rrm.nets.mlp import StackedMLP
from rrm.precision import Precision
from rrm.types import Segments, State

#: Of a deviation: what hardly moves at first may well move later.
_SMALLEST = 0.05


class EnsembleReward:
    """r(s, a) by every member (appendix "Model structure"), each bounded by tanh; the prior is not looked at."""

    on_prior = False  #: whether the prior's value is an input, and part of the sum
    _standard = False  # whether observations are shifted and scaled before they are looked at

    def __init__(
        self,
        config: RewardConfig,
        obs_dim: int,
        act_dim: int,
        generator: Generator | None,
        *,
        precision: Precision = "float32",
        device: str = CPU,
    ) -> None:
        """Args:
        generator: draws the initial weights, on whatever device; None leaves them zero, to be loaded.
        device: where rewards are computed, and what they are computed from is.
        """
        self._config = config
        self._standard = config.inputs == "standard"
        self._shift, self._factor = torch.zeros(obs_dim, device=device), torch.ones(obs_dim, device=device)
        self._linear = self.on_prior and config.bound == "gaussian"  # nothing bounds what the networks say
        self._net = StackedMLP(
            config.members, obs_dim + act_dim + self.on_prior, config.hidden, config.layers, 1,
            activation="leaky_relu", init="torch", generator=generator, precision=precision, device=device,
        )  # fmt: skip

    def begin(self, obs: Tensor) -> None:
        if self._standard:
            std, mean = torch.std_mean(obs, dim=0, correction=0)
            self._shift.copy_(mean)
            self._factor.copy_(1 / std.clamp(min=_SMALLEST))

    def members(self, segments: Segments) -> Tensor:
        return self._outputs(self._inputs(segments))

    def _inputs(self, segments: Segments) -> Tensor:
        """What the networks are shown of every step, [B, T, D]; [N, B, T, D] where each has inputs of its own."""
        return torch.cat([self._seen(segments.obs), self._beside(segments)], dim=-1)

    def _beside(self, segments: Segments) -> Tensor:
        """What they are shown beside the observation."""
        return torch.cat([segments.act, segments.prior.unsqueeze(-1)], dim=-1) if self.on_prior else segments.act

    def _seen(self, obs: Tensor) -> Tensor:
        """Observations as the networks are shown them, [..., O]."""
        return (obs - self._shift) * self._factor if self._standard else obs

    def _outputs(self, inputs: Tensor) -> Tensor:
        """[N, B, T], for inputs [B, T, D] shared by the members, or [N, B, T, D] of their own."""
        outputs = self._net(inputs.flatten(-3, -2))
        return (outputs if self._linear else torch.tanh(outputs)).view(-1, *inputs.shape[-3:-1])

    @torch.no_grad()
    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:
        steps = Segments(obs.unsqueeze(0), act.unsqueeze(0), prior.unsqueeze(0))
        return self.members(steps).mean(dim=0).squeeze(0)

    def penalty(self, rewards: Tensor, segments: Segments) -> Tensor:  # noqa: ARG002 (the seam other rewards use)
        return rewards.new_zeros(())  # the tanh is bound enough

    def parameters(self) -> list[Tensor]:
        return self._net.parameters()

    def state_dict(self) -> State:
        seen = {"shift": self._shift.clone(), "scale": self._factor.clone()} if self._standard else {}
        return {"weights": self._net.flat.clone(), **seen}

    def load_state_dict(self, state: State) -> None:
        self._net.flat.copy_(state["weights"])
        if self._standard:
            self._shift.copy_(state["shift"])
            self._factor.copy_(state["scale"])


class ResidualReward(EnsembleReward):
    """Prior plus residual, by every member of an ensemble."""

    on_prior = True

    def members(self, segments: Segments) -> Tensor:
        return segments.prior + super().members(segments)

    def penalty(self, rewards: Tensor, segments: Segments) -> Tensor:
        if not self._linear:
            return super().penalty(rewards, segments)
        return self._config.penalty * (rewards - segments.prior).square().mean(dim=(-2, -1)).sum()
