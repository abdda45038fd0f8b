"""DrM (Xu et al. 2024): DrQ-v2 that watches how many units of its actor are dormant.

While many are, it explores with more noise; now and then all linear layers are moved towards fresh ones, the further
the more are dormant; and the critics are in part regressed on what the best actions of the data are worth. Its code for
Meta-World is followed where the paper is silent. It awakens after the first random actions at the earliest, as nothing
is learned before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rrm.agents.drqv2 import Drq
from rrm.nets.tower import project

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import DrmConfig
    from rrm.envs.spaces import Spaces
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Batch, State

_NEVER = -1  # of the step since which it is awake


class Drm(Drq):
    """An `rrm.interfaces.Agent`; the arguments are those of `Drq`."""

    names = (*Drq.names, "dormant_ratio")
    config: DrmConfig

    def __init__(
        self,
        config: DrmConfig,
        spaces: Spaces,
        streams: Streams,
        *,
        precision: Precision = "float32",
        device: str = "cpu",
    ) -> None:
        super().__init__(config, spaces, streams, precision=precision, device=device)
        self.value = self._tower(1)
        self._train("value", self.value)
        self._dormant = torch.ones((), dtype=torch.float64, device=device)
        self._awake = torch.full_like(self._dormant, _NEVER)  # since this step
        self._perturbed = self._due = 0  # times

    @property
    def _dropout(self) -> float:
        return self.config.dropout

    @property
    def dormant_ratio(self) -> float:
        """Of the actor's units, at the last update."""
        return self._dormant.item()

    def _deviation(self) -> Tensor:
        dormant = torch.sigmoid(self.config.sharpness * (self._dormant - self.config.target_ratio))
        scheduled = self._scheduled(self._step - self._awake)
        return torch.where(self._awake == _NEVER, dormant, torch.maximum(dormant, scheduled))

    def at(self, step: int) -> None:
        super().at(step)
        self._due = step // self.config.perturb_every

    def update(self, batch: Batch) -> None:
        if self._due > self._perturbed:
            self._perturb()
            self._perturbed = self._due
        super().update(batch)

    def _learn(self) -> Sequence[Tensor]:
        return *super()._learn(), self._dormant

    @property
    def _changed(self) -> list[Tensor]:
        return [*super()._changed, self._dormant, self._awake]

    @torch.no_grad()
    def _perturb(self) -> None:
        config = self.config
        kept = min(max(1 - 2 * self.dormant_ratio, config.least_kept), config.most_kept)
        for tower in (self.actor, self.critic, self.target, self.value):
            tower.perturb(kept, self._init)
        for adam in self._adams.values():
            adam.reset()

    def _look(self, features: Tensor, act: Tensor) -> list[Tensor]:
        """Also count dormant units, and regress the value of the features on an upper expectile of the critics'."""
        pre_actor, pre_critic, pre_value = project(features, self.actor, self.critic, self.value)
        self._dormant.copy_(dormant_ratio(self.actor.outputs(pre_actor), self.config.dormant_share))
        awakens = (self._awake == _NEVER) & (self._dormant < self.config.target_ratio)
        self._awake.copy_(torch.where(awakens, self._step, self._awake))
        q = torch.minimum(*self._q(self.critic, pre_critic, act))
        with torch.enable_grad():
            pre_value = pre_value.detach().requires_grad_()
            error = self.value.outputs(pre_value)[-1][0, :, 0] - q
            above = (error > 0).float()
            weight = (1 - above) * self.config.expectile + above * (1 - self.config.expectile)
            loss = (weight * error.square()).mean()
        self._backward(self.value, loss, pre_value, features)
        self._adams["value"].step()
        return [pre_actor, pre_critic]

    def _value(self, features: Tensor, noise: Tensor) -> Tensor:
        """In part that of the data's best actions."""
        pre_actor, pre_target, pre = project(features, self.actor, self.target, self.value)
        share = self.config.exploitation
        return share * self.value.outputs(pre)[-1][0, :, 0] + (1 - share) * self._explored(pre_actor, pre_target, noise)

    def reset_critic(self) -> None:
        """The value with the critics: it was learned from them."""
        super().reset_critic()
        self.value.initialise(self._init)
        self._adams["value"].reset()

    def state_dict(self) -> State:
        awake = int(self._awake)
        own = {
            "dormant_ratio": self.dormant_ratio, "awake": None if awake == _NEVER else awake,
            "perturbed": self._perturbed,
        }  # fmt: skip
        return super().state_dict() | own

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        self._dormant.fill_(state["dormant_ratio"])
        self._awake.fill_(_NEVER if state["awake"] is None else state["awake"])
        self._perturbed = state["perturbed"]


def dormant_ratio(outputs: list[Tensor], share: float) -> Tensor:
    """Of all units of linear layers those whose mean size over a batch is below this share of their layer's mean: a
    scalar in double precision, where the outputs are.

    Args: outputs: of each layer, hidden ones after their ReLU, [..., B, units].
    """
    sizes = [layer.abs().mean(dim=-2).flatten() for layer in outputs]
    dormant = torch.stack([(size < share * size.mean()).sum() for size in sizes]).sum()
    return dormant.double() / sum(map(len, sizes))
