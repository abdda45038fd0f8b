"""The residual reward model: a prior known beforehand plus what preferences add to it (section 3, equation 3).

    r(s, a) = r0(s, a) + tanh(f(s, a, r0(s, a)))

The prior value is also an input of the network, so that the residual can cancel a prior it finds misleading. Whoever
trains or queries the reward sees the sum; nothing else in the library knows that there are two parts.

The tanh stands for a prior belief N(r; r0, sigma^2) about the reward (appendix "Motivating RRMs with MAP estimation").
With `reward.bound = "gaussian"` the residual is f itself, and what that belief adds to the loss is its penalty:
lambda f^2, in the mean over all steps of both segments. A reward without a prior has no r0 to be near: it keeps its
tanh, as PEBBLE's does, and `bound` means nothing to it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.rewards.ensemble import EnsembleReward
from rrm.types import Segments


class ResidualReward(EnsembleReward):
    """Prior plus residual, by every member of an ensemble."""

    extra_inputs = 1  #: the prior's value

    @property
    def _linear(self) -> bool:
        return self._config.bound == "gaussian"

    def members(self, segments: Segments) -> Tensor:
        inputs = torch.cat([segments.obs, segments.act, segments.prior.unsqueeze(-1)], dim=-1)
        return segments.prior + self._ensemble(inputs)

    def penalty(self, rewards: Tensor, segments: Segments) -> Tensor:
        if not self._linear:
            return super().penalty(rewards, segments)
        return self._config.penalty * (rewards - segments.prior).square().mean(dim=(-2, -1)).sum()
