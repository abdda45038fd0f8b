"""The residual reward model: a prior known beforehand plus what preferences add to it (section 3, equation 3).

    r(s, a) = r0(s, a) + tanh(f(s, a, r0(s, a)))

The prior value is also an input of the network, so that the residual can cancel a prior it finds misleading. Whoever
trains or queries the reward sees the sum; nothing else in the library knows that there are two parts.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.rewards.ensemble import EnsembleReward
from rrm.types import Segments


class ResidualReward(EnsembleReward):
    """Prior plus bounded residual, by every member of an ensemble."""

    extra_inputs = 1  #: the prior's value

    def members(self, segments: Segments) -> Tensor:
        inputs = torch.cat([segments.obs, segments.act, segments.prior.unsqueeze(-1)], dim=-1)
        return segments.prior + self._ensemble(inputs)
