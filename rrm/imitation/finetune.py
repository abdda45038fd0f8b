"""The baseline that the paper argues against: the imitation reward itself, trained further with preferences.

The same network g, a fresh Adam, no residual and no ensemble (appendix "Why fine-tuning a reward model fails"). The
norm of every gradient is recorded, so that what happens when the loss changes can be looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import torch
from torch import Tensor

from rrm.imitation.discriminator import RewardNet
from rrm.moments import RunningMoments
from rrm.parquet import write_table
from rrm.rewards.ensemble import EnsembleReward
from rrm.rewards.pebble import Pebble
from rrm.types import Segments, State

if TYPE_CHECKING:
    from rrm.config import RewardConfig

#: Names of losses, in the order of their codes in the log.
LOSSES = ("airl", "mse", "preferences")


class GradientLog:
    """Norm of the gradient in g's weights at every gradient step: environment step, loss, norm."""

    _TYPES: ClassVar = {"steps": np.int64, "losses": np.int8, "norms": np.float64}

    def __init__(self) -> None:
        self._columns: dict[str, list[float]] = {name: [] for name in self._TYPES}

    def add(self, step: int, loss: str, norm: float) -> None:
        """One more entry; `loss` is one of `LOSSES`."""
        for column, value in zip(self._columns.values(), (step, LOSSES.index(loss), norm), strict=True):
            column.append(value)

    def write(self, path: Path) -> None:
        """Replace the parquet file at `path`: columns `step`, `loss` (text) and `gradient_norm`."""
        import pyarrow as pa

        steps, losses, norms = map(pa.array, self.state_dict().values())
        names = pa.DictionaryArray.from_arrays(losses, pa.array(LOSSES))
        table = pa.table({"step": steps, "loss": names, "gradient_norm": norms})
        write_table(path, table)

    def state_dict(self) -> State:
        return {name: np.array(values, self._TYPES[name]) for name, values in self._columns.items()}

    def load_state_dict(self, state: State) -> None:
        self._columns = {name: state[name].tolist() for name in self._TYPES}


class ImitatedReward(EnsembleReward):
    """g as an ensemble of one member, without a prior, over the deviation of the reward that the agent had before."""

    def __init__(self, g: RewardNet, scale: RunningMoments) -> None:
        self._g, self._net, self._scale = g, g.net, scale

    def members(self, segments: Segments) -> Tensor:
        rewards = self._scale.over_std(self._g(torch.cat([segments.obs, segments.act], dim=-1)))
        return rewards if rewards.ndim == 3 else rewards.unsqueeze(0)

    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:  # noqa: ARG002 (the seam of residuals)
        return self._scale.over_std(self._g.predict(obs, act))

    def state_dict(self) -> State:
        return super().state_dict() | {"scale": self._scale.state_dict()}

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        self._scale.load_state_dict(state["scale"])


class Finetune(Pebble):
    """PEBBLE's sessions on g."""

    def __init__(
        self, reward: ImitatedReward, config: RewardConfig, rng: np.random.Generator, log: Callable[[str, float], None]
    ) -> None:
        """Args: log: told of every gradient step: the loss' name, and the norm of the gradient."""
        super().__init__(reward, config.model_copy(update={"members": 1}), rng)
        self._log = log

    def _step(self) -> None:
        gradients = [p.grad for p in self.reward.parameters() if p.grad is not None]
        self._log("preferences", float(torch.linalg.vector_norm(torch.cat([g.flatten() for g in gradients]))))
        super()._step()
