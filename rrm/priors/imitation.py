"""The prior that demonstrations make: the reward g(s, a) of an AIRL run, frozen (appendix "Imitation rewards").

Of the state before the step, as all priors of the paper, and of its frames where g looks at those: tanh((g - mean) /
deviation), with the mean and the deviation that g had on what the AIRL run saw. They are fixed, so that the order of g
is kept and most of it lies where the tanh is steep. No torch is imported before a prior is loaded.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from rrm.errors import MissingResultError, PriorError

if TYPE_CHECKING:
    from rrm.envs.spaces import FrameSpace
    from rrm.envs.tasks import Task
    from rrm.priors.step import PriorStep
    from rrm.types import State


def read_prior(path: Path, task: Task) -> State:
    """What the run that trained a prior on the task left of it: weights, shapes, and how good it was.

    Raises MissingResultError where the file is missing, damaged or another's, PriorError where it is of another task.
    """
    from rrm.checkpoint import read_networks

    kept: State | None = read_networks(path, "which holds the imitation prior").get("imitation")
    if kept is None:
        raise MissingResultError(f"{path} holds no imitation prior: another kind of run wrote it")
    if "std" not in kept:
        raise PriorError(f"{path} is a prior of an earlier version: run the experiment again, which trains another")
    if kept["task"] != task.name:
        raise PriorError(f"{path} was trained on {kept['task']}, not on {task.name}")
    return kept


class ImitationPrior:
    """g as it was kept by the run that trained it, on the same task; its z-score where nothing is squashed."""

    needs: tuple[tuple[str, ...], ...] = ((),)  #: of the features of the task

    def __init__(
        self,
        path: Path,
        task: Task,
        squash: Literal["none", "tanh"] = "tanh",
        frames: FrameSpace | None = None,
    ) -> None:
        """Args: frames: that the run's agent sees."""
        import torch

        from rrm.config import ImitationConfig
        from rrm.imitation.discriminator import RewardNet
        from rrm.imitation.visual import Eye

        kept = read_prior(path, task)
        self._eye = Eye.kept(kept) if "eye" in kept else None
        if self._eye is not None and self._eye.frames != frames:
            raise PriorError(f"{path} judges by {self._eye.frames}; this run's agent sees {frames or 'no frames'}")
        self._g = RewardNet(ImitationConfig(**kept["shape"]), kept["obs_dim"], kept["act_dim"], None)
        self._g.net.flat.copy_(kept["g"])
        self._row = torch.empty(1, kept["obs_dim"] + kept["act_dim"])
        self._mean, self._std = kept["mean"], kept["std"] or 1.0
        self._squash = squash == "tanh"

    def __call__(self, step: PriorStep) -> float:
        """Of the state before the step and the action."""
        import torch

        with torch.no_grad():
            seen = step.obs
            if self._eye is not None:
                if step.frames is None:
                    raise PriorError("it looks at frames, and is shown none")
                seen = self._eye(torch.from_numpy(step.frames)[None], torch.tensor(seen)[None])[0].numpy()
            self._row.copy_(torch.from_numpy(np.concatenate((seen, step.act))))
            score = (float(self._g(self._row)) - self._mean) / self._std
        return math.tanh(score) if self._squash else score
