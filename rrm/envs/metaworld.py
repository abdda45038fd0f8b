"""Meta-World v3 with the reward "v2", as the paper uses it: a fresh task instance at every reset, the goal visible.

The library's own ways to draw an instance are not used. With `_freeze_rand_vec=False` (B-Pref's way) it draws twice
per reset, and in window-open and door-unlock the first observation and the reward's margins then belong to the first
draw. Here the random vector comes from the environment's own stream and is frozen for the episode, which makes an
episode a pure function of that vector and its actions.

`info["success"]` is the library's, for the step at hand: it is not latched. The other entries of `info` are the
library's too, as floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import metaworld.env_dict
import mujoco
import numpy as np
from metaworld.sawyer_xyz_env import SawyerXYZEnv

from rrm.envs.base import MUJOCO_BOUND, Doubles, TaskEnv
from rrm.envs.camera import PEOPLE, Camera, Vantage
from rrm.envs.spaces import FrameSpace
from rrm.envs.tasks import task as task_of
from rrm.errors import ConfigError, NumericalError, UnknownNameError
from rrm.types import Floats, Pixels, State

#: Everything that integration depends on, the solver's warm start included.
_SPEC = mujoco.mjtState.mjSTATE_INTEGRATION
_LONGEST = int(SawyerXYZEnv.max_path_length)

#: From where people see hand, object and goal at once: from over the left shoulder; more from the side what the hand
#: would hide.
_VANTAGE = Vantage(120, -30, 1.1, (0.0, 0.68, 0.15))
_ASIDE = _VANTAGE._replace(azimuth=150)
_VANTAGES = {"button-press-v3": _ASIDE, "sweep-into-v3": _ASIDE}


class MetaWorldEnv(TaskEnv):
    """A task by its name there, "button-press-v3": 39 numbers in, 4 out (hand velocity in x, y, z; gripper effort)."""

    metadata = PEOPLE
    obs_dim = 39

    def __init__(self, task: str, horizon: int = _LONGEST, render_mode: str | None = None) -> None:
        super().__init__(
            -MUJOCO_BOUND, MUJOCO_BOUND, obs_dim=self.obs_dim, act_dim=4, horizon=horizon, render_mode=render_mode
        )  # fmt: skip
        if horizon > _LONGEST:
            raise ConfigError(f"horizon is {horizon}; Meta-World's episodes have {_LONGEST} steps at the most")
        classes: Any = metaworld.env_dict.ALL_V3_ENVIRONMENTS
        if task not in classes:
            raise UnknownNameError("Meta-World task", task, classes)
        self.sim = classes[task]()
        self.sim._set_task_called = True  # step() refuses to run otherwise
        self.sim._partially_observable = False
        # The cached space has the hidden goal's bounds, zero and zero, to which every step's observation is clipped.
        self.sim.__dict__.pop("sawyer_observation_space", None)
        self.sim._freeze_rand_vec = True
        self._task = task
        self._vector = np.zeros(0)
        self._camera = Camera(self.sim.model)

    @property
    def rate(self) -> float:
        return float(1 / self.sim.dt)

    def _begin(self) -> Doubles:
        return self._start(self._draw())

    def _draw(self) -> Doubles:
        space = self.sim._random_reset_space
        while True:
            vector: Doubles = self.np_random.uniform(space.low, space.high)
            # Sweep-into repeats its draw until the puck is clear of the hole; with a frozen vector, forever.
            if self._task != "sweep-into-v3" or np.linalg.norm(vector[:2] - self.sim.goal[:2]) >= 0.15:
                return vector

    def _start(self, vector: Doubles) -> Doubles:
        self._vector = vector
        self.sim._last_rand_vec = vector.copy()
        obs: Doubles = self.sim.reset()[0]
        return obs

    def _advance(self, action: Doubles) -> tuple[Doubles, float, dict[str, float]]:
        before = self.sim.data.time
        obs, reward, _, _, info = self.sim.step(action)
        if self.sim.data.time <= before:  # MuJoCo restarts a simulation that diverges, clock included
            raise NumericalError(f"the simulation diverged at step {self._steps} under action {action.tolist()}")
        return obs, reward, {name: float(value) for name, value in info.items()}

    def _save(self) -> State:
        sim = self.sim
        physics = np.empty(mujoco.mj_stateSize(sim.model, _SPEC))
        mujoco.mj_getState(sim.model, sim.data, physics, _SPEC)
        return {
            "vector": self._vector.copy(),
            "physics": physics,
            "previous_obs": sim._prev_obs.copy(),
            "path_length": sim.curr_path_length,
        }

    def _restore(self, state: State) -> None:
        sim = self.sim
        # The reset rebuilds what is not in MuJoCo's state: moved bodies and sites of the model, the goal, the margins
        # of the reward, and attributes that are live views into the simulation (copies would change the reward).
        self._start(np.array(state["vector"], dtype=np.float64))
        physics = np.asarray(state["physics"], dtype=np.float64)
        mujoco.mj_setState(sim.model, sim.data, physics, _SPEC)
        mujoco.mj_forward(sim.model, sim.data)
        mujoco.mj_setState(sim.model, sim.data, physics, _SPEC)  # forward overwrote the warm start
        sim._prev_obs = np.array(state["previous_obs"], dtype=np.float64)
        sim.curr_path_length = int(state["path_length"])

    def render(self) -> Pixels | None:
        """The robot and its object for people, uint8 [360, 480, 3] RGB; None without a render mode."""
        if self.render_mode is None:
            return None
        return self._camera.portrait(self.sim.data, _VANTAGES.get(self._task, _VANTAGE))

    def close(self) -> None:
        self._camera.close()
        self.sim.close()


class MetaWorldImageEnv(MetaWorldEnv):
    """The same task with a camera, and what its robot knows without looking: 10 numbers in.

    0:3 the hand, 3 the opening of its gripper, 4:7 where the object was when the episode began, 7:10 the goal. Views
    are Meta-World's cameras.
    """

    obs_dim = 10

    def __init__(self, task: str, horizon: int = _LONGEST, render_mode: str | None = None) -> None:
        super().__init__(task, horizon, render_mode)
        self.full_obs: Floats = np.zeros(39, np.float32)  #: what the task's other half, without a camera, shows now
        self._object_start = np.zeros(3)

    def _start(self, vector: Doubles) -> Doubles:
        full = super()._start(vector)
        self._object_start = full[4:7].copy()
        return self._known(full)

    def _known(self, full: Doubles) -> Doubles:
        self.full_obs = full.astype(np.float32)
        return np.concatenate((full[:4], self._object_start, full[36:]))

    def _advance(self, action: Doubles) -> tuple[Doubles, float, dict[str, float]]:
        full, reward, info = super()._advance(action)
        return self._known(full), reward, info

    def frame(self, space: FrameSpace) -> Pixels:
        """What a camera sees, upright: Meta-World mounts those in the corners head first."""
        picture = self._camera.picture(self.sim.data, space)
        return picture[::-1, ::-1] if space.view.startswith("corner") else picture

    def _save(self) -> State:
        return super()._save() | {"full_obs": self.full_obs}

    def _restore(self, state: State) -> None:
        super()._restore(state)
        self.full_obs = np.array(state["full_obs"], np.float32)


def scripted_policy(name: str) -> Callable[[Floats], Floats]:
    """The policy that Meta-World ships for a task: from observation to action, both float32; actions may exceed 1."""
    spec = task_of(name)
    if spec.suite != "metaworld":
        raise ConfigError(f"{name} has no scripted policy: Meta-World ships them for its own observations alone")
    from metaworld.policies import ENV_POLICY_MAP

    policy: Any = ENV_POLICY_MAP[spec.kwargs["task"]]()  # type: ignore[abstract]  # each entry is a finished class

    def act(obs: Floats) -> Floats:
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # that actions exceed 1, as is said here
            return np.asarray(policy.get_action(obs.astype(np.float64)), np.float32)

    return act
