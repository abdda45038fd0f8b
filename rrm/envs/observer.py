"""What an agent sees of an environment: its observation and, where the task has a camera, the newest frames."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.tasks import make
from rrm.types import Obs

if TYPE_CHECKING:
    from rrm.envs.base import TaskEnv
    from rrm.envs.spaces import FrameSpace
    from rrm.envs.tasks import Ranges
    from rrm.types import Floats, Pixels, State


class Observer:
    """An environment whose observations are an agent's, and whose steps are.

    Priors, teachers and rewards read the state alone; a camera looks at what the simulator holds and changes nothing.
    The first frame of an episode stands for those before it.
    """

    def __init__(
        self,
        env: str | TaskEnv,
        horizon: int | None = None,
        frames: FrameSpace | None = None,
        repeat: int = 1,
        ranges: Ranges | None = None,
    ) -> None:
        """Args:
        env, horizon, ranges: as for `rrm.envs.make`, which raises as it does; or one that is there.
        frames: what a camera shows; None where nobody looks.
        repeat: steps of the environment that one action lasts. Their rewards are added up; one with success is enough.
        """
        self.env = make(env, horizon, ranges) if isinstance(env, str) else env
        self._space = frames
        self._repeat = repeat
        self._frames: deque[Pixels] = deque(maxlen=frames.stack if frames else 0)

    def reset(self, seed: int | None = None) -> Obs:
        """Start an episode; a seed restarts the stream from which task instances are drawn."""
        state, _ = self.env.reset(seed=seed)
        if self._space is not None:
            self._frames.extend([self._frame(self._space)] * self._space.stack)
        return self.seen(state)

    def step(self, action: Floats) -> tuple[Obs, float, bool, bool, dict[str, Any]]:
        """One step, as an environment's."""
        total, success, over = 0.0, -np.inf, False
        for _ in range(self._repeat):
            state, reward, terminated, truncated, info = self.env.step(action)
            total, over = total + reward, terminated or truncated
            if "success" in info:
                info["success"] = success = max(success, info["success"])
            if over:
                break
        if self._space is not None:
            self._frames.append(self._frame(self._space))
        return self.seen(state), total, terminated, truncated, info

    def _frame(self, space: FrameSpace) -> Pixels:
        return np.ascontiguousarray(self.env.frame(space).transpose(2, 0, 1))

    def seen(self, state: Floats) -> Obs:
        """A state with the frames up to it."""
        return Obs(state, None if self._space is None else np.stack(self._frames))

    def state_dict(self) -> State:
        state = self.env.state_dict()
        return state if self._space is None else {"env": state, "frames": np.stack(self._frames)}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken. Frames are kept, since another machine may draw them otherwise."""
        if self._space is not None:
            self._frames.extend(state["frames"])
            state = state["env"]
        self.env.load_state_dict(state)

    def close(self) -> None:
        """Free the simulator."""
        self.env.close()
