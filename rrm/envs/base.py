"""What every environment of ours does the same way: checked actions, a time limit, a random stream, and a saved state.

An environment fills in four methods: draw an episode, advance by one step, save the simulator, restore it.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box

from rrm.errors import ConfigError, NumericalError
from rrm.types import Floats, Pixels, State

if TYPE_CHECKING:
    from rrm.envs.spaces import FrameSpace

Doubles = npt.NDArray[np.float64]

#: MuJoCo restarts a simulation in which a position, speed or acceleration leaves this bound (its `mjMAXVAL`), so no
#: observation of a sound one does. The simulators know no tighter bound that always holds.
MUJOCO_BOUND = 1e10


class TaskEnv(gymnasium.Env[Floats, Floats]):
    """A gymnasium environment whose simulator can be saved in mid-episode.

    Observations are float32 [O] with every feature of its `Task`; `reward` is the true reward; `info["success"]` is 0.0
    or 1.0 for this step on tasks that have the notion. Episodes end at the horizon, by truncation, never earlier.

    Args:
        low, high: bounds of the observation, broadcast to `obs_dim`; actions lie in [-1, 1].
        render_mode: one of the class' `metadata["render_modes"]`, or None.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  (gymnasium declares it so)

    def __init__(
        self,
        low: npt.ArrayLike,
        high: npt.ArrayLike,
        *,
        obs_dim: int,
        act_dim: int,
        horizon: int,
        render_mode: str | None,
    ) -> None:
        if horizon < 1:
            raise ConfigError(f"horizon is {horizon}; an episode has at least one step")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            modes = ", ".join(self.metadata["render_modes"]) or "none"
            raise ConfigError(f'render_mode "{render_mode}" is not one of {type(self).__name__}; it has: {modes}')
        lowest, highest = (np.broadcast_to(np.asarray(bound, np.float32), obs_dim) for bound in (low, high))
        self.observation_space: Box[np.float32] = Box(lowest, highest, dtype=np.float32)
        self.action_space: Box[np.float32] = Box(-1.0, 1.0, (act_dim,), dtype=np.float32)
        self.render_mode = render_mode
        self.horizon = horizon
        self._steps: int | None = None  # None before the first reset

    @property
    def rate(self) -> float:
        """Steps a second of its own time; overridden where pictures for people are shown at another rate."""
        return float(self.metadata["render_fps"])

    @abstractmethod
    def _begin(self) -> npt.ArrayLike:
        """Draw a task instance from `np_random`, start the episode and return its first observation."""

    @abstractmethod
    def _advance(self, action: Doubles) -> tuple[npt.ArrayLike, float, dict[str, float]]:
        """One step under an action in [-1, 1]: observation, true reward, info."""

    @abstractmethod
    def _save(self) -> State:
        """The simulator and the task instance, in mid-episode."""

    @abstractmethod
    def _restore(self, state: State) -> None:
        """Undo `_save`, in an environment that may never have been reset."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode; a seed restarts the stream from which task instances are drawn."""
        super().reset(seed=seed, options=options)
        obs = np.array(self._begin(), dtype=np.float32)
        self._steps = 0
        return obs, {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One step; an action beyond [-1, 1] counts as the nearest inside. `NumericalError`: not finite or diverged."""
        if self._steps is None or self._steps >= self.horizon:
            raise ResetNeeded("the episode has not begun or is over; call reset() before step()")
        act = np.asarray(action, dtype=np.float64)
        if act.shape != self.action_space.shape:
            raise ValueError(f"an action has shape {self.action_space.shape}; this one has {act.shape}")
        # A simulator might not refuse it: Meta-World's restarts its physics and goes on with a meaningless state.
        if not np.isfinite(act).all():
            raise NumericalError(f"action {act.tolist()} at step {self._steps} of the episode is not finite")
        obs, reward, info = self._advance(np.minimum(np.maximum(act, -1.0), 1.0))
        self._steps += 1
        return np.array(obs, dtype=np.float32), float(reward), False, self._steps >= self.horizon, info

    def frame(self, space: FrameSpace) -> Pixels:  # noqa: ARG002 (the seam of others)
        """A camera's picture of the simulator as it is, [height, width, channels]; overridden where there is one."""
        raise TypeError(f"{type(self).__name__} has no camera")

    def state_dict(self) -> State:
        """Simulator, task instance, step counter and random stream, at any moment between two steps."""
        return {
            "steps": self._steps,
            "rng": self.np_random.bit_generator.state,
            "simulator": None if self._steps is None else self._save(),
        }

    def load_state_dict(self, state: State) -> None:
        """Continue from `state_dict`, bit for bit, in any process of the same machine type."""
        if state["simulator"] is not None:
            self._restore(state["simulator"])
        self._steps = state["steps"]
        # Last, because restoring a simulator may go through a reset that draws.
        self.np_random.bit_generator.state = state["rng"]
