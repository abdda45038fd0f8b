"""The prior that demonstrations make: the reward g(s, a) of an AIRL run, frozen (appendix "Imitation rewards").

Of the state before the step, as all priors of the paper. Its value has no bound; `squash: tanh` gives it one. No torch
is imported before a prior is loaded.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from rrm.errors import MissingResultError, PriorError

if TYPE_CHECKING:
    from rrm.envs.tasks import Task
    from rrm.priors.step import PriorStep


class ImitationPrior:
    """g as it was kept by the run that trained it, on the same task; `squash` bounds it to (-1, 1) with a tanh."""

    needs: tuple[tuple[str, ...], ...] = ((),)  #: of the features of the task

    def __init__(self, path: Path, task: Task, squash: Literal["none", "tanh"] = "none") -> None:
        import torch

        from rrm.checkpoint import read_networks
        from rrm.config import ImitationConfig
        from rrm.imitation.discriminator import RewardNet

        kept = read_networks(path, "which holds the imitation prior").get("imitation")
        if kept is None:
            raise MissingResultError(f"{path} holds no imitation prior: another kind of run wrote it")
        if kept["task"] != task.name:
            raise PriorError(f"{path} was trained on {kept['task']}, not on {task.name}")
        self._g = RewardNet(ImitationConfig(**kept["shape"]), kept["obs_dim"], kept["act_dim"], None)
        self._g.net.flat.copy_(kept["g"])
        self._row = torch.empty(1, kept["obs_dim"] + kept["act_dim"])
        self._squash = squash == "tanh"

    def __call__(self, step: PriorStep) -> float:
        """G of the state before the step and the action."""
        import torch

        self._row.copy_(torch.from_numpy(np.concatenate((step.obs, step.act))))
        with torch.no_grad():
            raw = float(self._g(self._row))
        return math.tanh(raw) if self._squash else raw
