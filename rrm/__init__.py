"""Reward learning from preferences on top of known priors: the residual reward model and what it is compared with.

What a notebook needs is here by name: `make` a task of `TASKS`, describe a run by a `RunConfig`, `train` it, `load` it
when it is finished, and put its reward under somebody else's loop with `LearnedReward`. Nothing heavy is imported
before it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rrm.config import (
        EvaluationConfig,
        ExplorationConfig,
        FeedbackConfig,
        RewardConfig,
        SacConfig,
        TeacherConfig,
    )
    from rrm.envs import TASKS, make
    from rrm.runs import Finished, LearnedReward, load, train
    from rrm.training.run_config import RunConfig

__version__ = "0.1.0"

_HOMES = {
    **dict.fromkeys(("TASKS", "make"), "rrm.envs"),
    "RunConfig": "rrm.training.run_config",
    **dict.fromkeys(
        (
            "SacConfig", "EvaluationConfig", "ExplorationConfig", "FeedbackConfig", "RewardConfig", "TeacherConfig"
        ), "rrm.config"
    ),
    **dict.fromkeys(("Finished", "LearnedReward", "load", "train"), "rrm.runs"),
}  # fmt: skip

__all__ = [
    "TASKS",
    "EvaluationConfig",
    "ExplorationConfig",
    "FeedbackConfig",
    "Finished",
    "LearnedReward",
    "RewardConfig",
    "RunConfig",
    "SacConfig",
    "TeacherConfig",
    "load",
    "make",
    "train",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
