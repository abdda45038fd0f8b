"""DM-Control's walker-walk and quadruped-walk as gymnasium environments; the paper reports their return.

Observations are the suite's, concatenated in its own order. Actions lie in [-1, 1] and are mapped to the suite's
bounds, which differ from joint to joint in the quadruped. The true reward is the suite's, in [0, 1]; there is no
success criterion. `info` holds the outcomes of `rrm.envs.tasks`, read from the suite's accessors after the step.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

from rrm.envs.base import MUJOCO_BOUND, Doubles, TaskEnv
from rrm.envs.camera import PEOPLE, Camera, Vantage
from rrm.errors import ConfigError, NumericalError
from rrm.types import Pixels, State

with warnings.catch_warnings(action="ignore"):  # without a display, its search for OpenGL warns; nothing is rendered
    from dm_control import suite
    from dm_control.rl.control import PhysicsError

#: Everything that integration depends on, the solver's warm start included.
_SPEC = mujoco.mjtState.mjSTATE_INTEGRATION
_LONGEST = 1000
#: Goes along with the torso; the height it looks at stays.
_VANTAGE = Vantage(90, -15, 4.5, (0.0, 0.0, 0.9))

#: The suite's accessors of what a step led to, by domain. Speeds in m/s, heights in metres.
_OUTCOMES: dict[str, dict[str, Callable[[Any], float]]] = {
    "walker": {
        "torso_upright": lambda physics: physics.torso_upright(),
        "torso_height": lambda physics: physics.torso_height(),
        "forward_velocity": lambda physics: physics.horizontal_velocity(),  # of the centre of mass
    },
    "quadruped": {
        "torso_upright": lambda physics: physics.torso_upright(),
        "forward_velocity": lambda physics: physics.torso_velocity()[0],  # in the torso's frame
    },
}


class DmcEnv(TaskEnv):
    """A task of the suite by its names, such as "walker" and "walk"; episodes have 1000 steps at the most."""

    metadata = PEOPLE

    def __init__(self, domain: str, task: str, horizon: int = _LONGEST, render_mode: str | None = None) -> None:
        if (domain, task) not in suite.ALL_TASKS:
            raise ConfigError(f"DM-Control's suite has no task {task!r} in domain {domain!r}")
        if horizon > _LONGEST:
            raise ConfigError(f"horizon is {horizon}; the suite's episodes have {_LONGEST} steps at the most")
        self.sim = suite.load(domain, task, task_kwargs={"random": 0})  # seeded anew at every reset
        self._outcomes = _OUTCOMES.get(domain, {})
        self._camera = Camera(self.sim.physics.model.ptr)
        actions = self.sim.action_spec()
        self._middle = (actions.maximum + actions.minimum) / 2
        self._half = (actions.maximum - actions.minimum) / 2
        # The quadruped looks its sensors up by `np.in1d` the first time it is asked, and remembers them.
        with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
            obs_dim = sum(int(np.prod(spec.shape)) for spec in self.sim.observation_spec().values())
        sizes = {"obs_dim": obs_dim, "act_dim": actions.shape[0], "horizon": horizon}
        super().__init__(-MUJOCO_BOUND, MUJOCO_BOUND, **sizes, render_mode=render_mode)

    @property
    def rate(self) -> float:
        return float(1 / self.sim.control_timestep())

    def _begin(self) -> Doubles:
        self.sim.task.random.seed(int(self.np_random.integers(2**32)))
        return _flat(self.sim.reset().observation)

    def _advance(self, action: Doubles) -> tuple[Doubles, float, dict[str, float]]:
        try:
            step = self.sim.step(self._middle + self._half * action)
        except PhysicsError as error:
            raise NumericalError(
                f"the simulation diverged at step {self._steps} under action {action.tolist()}: {error}"
            ) from error
        physics = self.sim.physics
        return _flat(step.observation), step.reward, {name: float(of(physics)) for name, of in self._outcomes.items()}

    def _save(self) -> State:
        physics = self.sim.physics
        state = np.empty(mujoco.mj_stateSize(physics.model.ptr, _SPEC))
        mujoco.mj_getState(physics.model.ptr, physics.data.ptr, state, _SPEC)
        return {"physics": state, "step_count": self.sim._step_count}

    def _restore(self, state: State) -> None:
        self.sim.reset()
        physics = self.sim.physics
        mujoco.mj_setState(physics.model.ptr, physics.data.ptr, np.asarray(state["physics"], dtype=np.float64), _SPEC)
        # The suite finishes a step with the first half of the next (positions and velocities), which must be redone.
        mujoco.mj_step1(physics.model.ptr, physics.data.ptr)
        self.sim._step_count = int(state["step_count"])

    def render(self) -> Pixels | None:
        """The body from its side, for people, uint8 [360, 480, 3] RGB; None without a render mode."""
        if self.render_mode is None:
            return None
        physics = self.sim.physics
        x, y, _ = physics.named.data.xpos["torso"]
        return self._camera.portrait(physics.data.ptr, _VANTAGE._replace(lookat=(x, y, _VANTAGE.lookat[2])))

    def close(self) -> None:
        self._camera.close()
        self.sim.close()


def _flat(observation: Mapping[str, Doubles]) -> Doubles:
    return np.concatenate([np.ravel(part) for part in observation.values()])
