"""A short walk through a task at random, on which candidates are tried. The true reward is not kept."""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from rrm.envs.tasks import Task, make
from rrm.interfaces import Floats
from rrm.seeding import Streams

EPISODES = 4
_HELD = 25  # steps for which an action of every other episode is held: single ones cancel out and lead nowhere

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """What was lived through: `N` episodes of `T` steps."""

    obs: Floats  #: [N, T, O], before each step
    act: Floats  #: [N, T, A]
    outcomes: Doubles  #: [N, T, K], in the order of `Task.outcomes`

    def encode(self) -> bytes:
        """For another process; `decode` is the inverse."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **asdict(self))
        return buffer.getvalue()

    @classmethod
    def decode(cls, data: bytes) -> Walk:
        """What `encode` made."""
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return cls(**arrays)


def walk(task: Task) -> Walk:
    """Full episodes of uniform actions, fresh ones at every step and held ones in turn; always the same for a task."""
    rng = Streams(0).numpy("language")
    env = make(task.name)
    obs = np.empty((EPISODES, task.horizon, task.obs_dim), np.float32)
    outcomes = np.empty((EPISODES, task.horizon, len(task.outcomes)))
    drawn = rng.uniform(-1.0, 1.0, (EPISODES, task.horizon, task.act_dim)).astype(np.float32)
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
