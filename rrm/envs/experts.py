"""Meta-World's own scripted policies: experts that need no training."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from rrm.envs.tasks import task
from rrm.errors import ConfigError
from rrm.types import Floats


def scripted_policy(name: str) -> Callable[[Floats], Floats]:
    """The policy that Meta-World ships for a task: from observation to action, both float32; actions may exceed 1.

    Raises:
        UnknownNameError: there is no such task.
        ConfigError: it is not one of Meta-World's.
    """
    spec = task(name)
    if spec.suite != "metaworld":
        raise ConfigError(
            f"{name} has no scripted policy: only Meta-World ships them, and this is of suite {spec.suite}"
        )
    from metaworld.policies import ENV_POLICY_MAP

    policy: Any = ENV_POLICY_MAP[spec.kwargs["task"]]()  # type: ignore[abstract]  # each entry is a finished class

    def act(obs: Floats) -> Floats:
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # that actions exceed 1, as is said here
            return np.asarray(policy.get_action(obs.astype(np.float64)), np.float32)

    return act
