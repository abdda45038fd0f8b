"""Reach, Push and Pick-and-Reach in PyBullet: `rrm.envs.panda.rules` played in a `rrm.envs.panda.scene`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from rrm.envs.base import Doubles, TaskEnv
from rrm.envs.panda.physics import RATE, Pose, Vector, varied
from rrm.envs.panda.rules import NEAR, RULES
from rrm.envs.panda.scene import Scene, View
from rrm.errors import NumericalError
from rrm.types import Pixels, State

_VIEW = View(eye=(1.15, -0.6, 0.62), target=(0.42, 0.0, 0.19))
_FARTHEST = 2.0  # metres that no observation exceeds


class PandaEnv(TaskEnv):
    """A task by its name in `RULES`.

    Args:
        horizon: steps of an episode.
        render_mode: "rgb_array" for pictures of 480 x 360, or None.
        ranges: what of the physics is drawn anew at every reset, from where to where.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": RATE}  # noqa: RUF012  (gymnasium declares it so)

    def __init__(
        self,
        task: str,
        horizon: int = 100,
        render_mode: str | None = None,
        ranges: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        self.rules = rules = RULES[task]
        high = rules.observe((_FARTHEST,) * 3, Pose((_FARTHEST,) * 3, math.pi), (_FARTHEST,) * 3)
        sizes = {"obs_dim": len(high), "act_dim": rules.dims, "horizon": horizon}
        super().__init__([-bound for bound in high], high, **sizes, render_mode=render_mode)
        self.scene = Scene()
        self.goal: Vector = (0.0, 0.0, 0.0)
        self._ranges = ranges
        self._closed = True
        self._seen = Pose((0.0, 0.0, 0.0), 0.0)  # the cube, as it was last observed
        self._origin: State = {}  # of the random stream, before the episode was drawn
        self._played: list[Doubles] = []

    def _begin(self) -> list[float]:
        self._origin, self._played = dict(self.np_random.bit_generator.state), []
        physics = varied(self._ranges, self.np_random)
        cube, self.goal = self.rules.draw(self.np_random, physics)
        self._closed = not self.rules.picks
        self.scene.place(self.rules.start, cube, physics, self.rules.limits(physics), closed=self._closed)
        return self._observe()

    def _advance(self, action: Doubles) -> tuple[list[float], float, dict[str, float]]:
        rules, scene = self.rules, self.scene
        self._closed = rules.closed(scene.hand, self._seen.position, self._closed)
        scene.step(rules.velocity(action.tolist()), closed=self._closed)
        self._played.append(action)
        hand, cube = scene.hand, scene.cube.position
        if not np.isfinite((hand, cube)).all():
            raise NumericalError(f"the simulation diverged at step {self._steps} under action {action.tolist()}")
        success = not scene.lost and rules.left(hand, cube, self.goal) < NEAR
        return self._observe(), rules.reward(hand, cube, self.goal), {"success": float(success)}

    def _observe(self) -> list[float]:
        hand, cube, physics = self.scene.hand, self.scene.cube, self.scene.physics
        if physics.noise:
            x, y, z, turn = (physics.noise * self.np_random.standard_normal(4)).tolist()
            (cx, cy, cz), yaw = cube
            turned = math.remainder(yaw + turn / (physics.cube_size / 2), math.tau)
            cube = Pose((cx + x, cy + y, cz + z), turned)
        self._seen = cube
        return self.rules.observe(hand, cube, self.goal)

    def _save(self) -> State:
        """How the episode came about: PyBullet's own saved state is not exact while the hand holds something."""
        return {"origin": self._origin, "actions": np.reshape(self._played, (-1, self.rules.dims))}

    def _restore(self, state: State) -> None:
        self.np_random.bit_generator.state = state["origin"]
        self._begin()
        for action in np.array(state["actions"], np.float64):
            self._advance(action)

    def render(self) -> Pixels | None:
        """The table from the front right, the goal as a ball; uint8 [360, 480, 3] RGB. None without a render mode."""
        if self.render_mode is None:
            return None
        return self.scene.picture(_VIEW, 480, 360, ball=self.goal if self.rules.moves else None)

    def close(self) -> None:
        self.scene.close()
