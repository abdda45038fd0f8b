"""A short walk through a task at random, on which candidates are tried. The true reward is not kept."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rrm.envs.tasks import Task, make
from rrm.errors import PriorError
from rrm.priors.calling import evaluate_prior
from rrm.priors.step import PriorStep, Scene
from rrm.seeding import Streams
from rrm.types import Floats

EPISODES = 4
_HELD = 25  # steps for which an action of every other episode is held: single ones cancel out and lead nowhere

SECONDS = 60  #: that a candidate may take for a walk; a single step always ends

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """What was lived through: `N` episodes of `T` steps."""

    obs: Floats  #: [N, T, O], before each step
    act: Floats  #: [N, T, A]
    outcomes: Doubles  #: [N, T, K], in the order of `Task.outcomes`


def walk(task: Task) -> Walk:
    """Full episodes of uniform actions, fresh ones at every step and held ones in turn; always the same for a task."""
    rng = Streams(0).numpy("language")
    env = make(task.name)
    obs = np.empty((EPISODES, task.horizon, task.spaces.obs), np.float32)
    outcomes = np.empty((EPISODES, task.horizon, len(task.outcomes)))
    drawn = rng.uniform(-1.0, 1.0, (EPISODES, task.horizon, task.spaces.act)).astype(np.float32)
    drawn[1::2] = drawn[1::2, np.arange(task.horizon) // _HELD]
    try:
        for episode in range(EPISODES):
            seen, _ = env.reset(seed=int(rng.integers(2**31)))
            for step in range(task.horizon):
                obs[episode, step] = seen
                seen, _, _, _, info = env.step(drawn[episode, step])
                outcomes[episode, step] = [info[name] for name in task.outcomes]
    finally:
        env.close()
    return Walk(obs, drawn, outcomes)


def values(
    prior: Callable[[PriorStep], float], task: Task, lived: Walk, name: str, seconds: float = SECONDS
) -> Doubles:
    """The prior's value of every step, as a run would show it, float64 [N, T].

    Raises:
        PriorError: it fails, or is too slow to train with.
    """
    rng = np.random.default_rng(0)  # part of a step, and out of the code's reach
    result = np.empty(lived.outcomes.shape[:2])
    end = time.monotonic() + seconds
    with warnings.catch_warnings(action="ignore"):  # of numpy, about numbers that are seen to be finite here
        for episode, step in np.ndindex(result.shape):
            obs, info = (
                lived.obs[episode],
                dict(zip(task.outcomes, lived.outcomes[episode, step].tolist(), strict=True)),
            )
            seen = PriorStep(task, obs[step], lived.act[episode, step], info, rng, Scene(task, obs[0]))
            result[episode, step] = evaluate_prior(prior, seen, f"{name} at step {step}")
            if time.monotonic() > end:
                raise PriorError(
                    f"{name}: too slow, {step + 1 + episode * len(obs):,} steps took more than {seconds:g} s"
                )
    return result
