"""What an agent sees of an environment: its observation and, where the task has a camera, the newest frames."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.tasks import make, task
from rrm.types import Obs

if TYPE_CHECKING:
    from rrm.types import Floats, Pixels, State


class Observer:
    """An environment whose observations are an agent's.

    Priors, teachers and rewards read the state alone; a camera looks at what the simulator holds and changes nothing.
    The first frame of an episode stands for those before it.
    """

    def __init__(self, name: str, horizon: int | None = None) -> None:
        """Args: as for `rrm.envs.make`. Raises as it does."""
        self.env = make(name, horizon=horizon)
        space = task(name).spaces.frames
        self._frames: deque[Pixels] | None = None if space is None else deque(maxlen=space.stack)

    def reset(self, seed: int | None = None) -> Obs:
        """Start an episode; a seed restarts the stream from which task instances are drawn."""
        state, _ = self.env.reset(seed=seed)
        if self._frames is not None:
            self._frames.extend([self.env.frame()] * self._frames.maxlen)  # type: ignore[operator]  # it has a length
        return self.seen(state)

    def step(self, action: Floats) -> tuple[Obs, float, bool, bool, dict[str, Any]]:
        """One step, as an environment's."""
        state, reward, terminated, truncated, info = self.env.step(action)
        if self._frames is not None:
            self._frames.append(self.env.frame())
        return self.seen(state), reward, terminated, truncated, info

    def seen(self, state: Floats) -> Obs:
        """A state with the frames up to it."""
        return Obs(state, None if self._frames is None else np.stack(self._frames))

    def state_dict(self) -> State:
        state = self.env.state_dict()
        return state if self._frames is None else {"env": state, "frames": np.stack(self._frames)}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken. Frames are kept, since another machine may draw them otherwise."""
        if self._frames is not None:
            self._frames.extend(state["frames"])
            state = state["env"]
        self.env.load_state_dict(state)

    def close(self) -> None:
        """Free the simulator."""
        self.env.close()
