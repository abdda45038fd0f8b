"""The toy car seen from above: its dynamics and its reward, without obstacles, on the way to a goal that never moves.

At every reset the car starts at rest somewhere on a ring around the goal, 1.75 to 2.25 m away. Quick to simulate, to
draw and to learn from pictures: what tests of agents that see need.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rrm.envs.base import Doubles, TaskEnv
from rrm.envs.spaces import FrameSpace
from rrm.envs.toy_car import ARENA, GOAL_RADIUS, TOP_SPEED, Layout, Point, ToyCarEnv, drive, true_reward

if TYPE_CHECKING:
    from rrm.types import Pixels, State

_NOWHERE: Point = (math.inf, math.inf)
_LAYOUT = Layout((0.0, 0.0), (_NOWHERE,) * 3)
_FOR_PEOPLE = FrameSpace(320, 320)
_CAR_RADIUS = 0.25  # metres; drawn larger than it is, so that a few pixels show where it is between them
_GROUND, _GOAL, _CAR = ((245.0, 245.0, 245.0), (120.0, 200.0, 120.0), (60.0, 90.0, 200.0))  # RGB


class ToyCarImageEnv(TaskEnv):
    """The car's position (m), its velocity (m/s) and the goal's position in 6 numbers; the view is "above"."""

    metadata = ToyCarEnv.metadata

    def __init__(self, horizon: int = 100, render_mode: str | None = None) -> None:
        high = [ARENA] * 2 + [TOP_SPEED] * 2 + [ARENA] * 2
        sizes = {"obs_dim": 6, "act_dim": 2, "horizon": horizon}
        super().__init__([-bound for bound in high], high, **sizes, render_mode=render_mode)
        self.position: Point = (0.0, 0.0)
        self.velocity: Point = (0.0, 0.0)

    def _begin(self) -> list[float]:
        turn, away = self.np_random.uniform((-math.pi, 1.75), (math.pi, 2.25)).tolist()
        self.position, self.velocity = (away * math.cos(turn), away * math.sin(turn)), (0.0, 0.0)
        return self._observe()

    def _observe(self) -> list[float]:
        return [*self.position, *self.velocity, *_LAYOUT.goal]

    def _advance(self, action: Doubles) -> tuple[list[float], float, dict[str, float]]:
        pull = (float(action[0]), float(action[1]))
        self.position, self.velocity = drive(_LAYOUT, self.position, self.velocity, pull)
        distance = math.dist(self.position, _LAYOUT.goal)
        reward = true_reward(distance, math.inf, math.hypot(*self.velocity))
        return self._observe(), reward, {"success": float(distance < GOAL_RADIUS)}

    def frame(self, space: FrameSpace) -> Pixels:
        """The arena from above, the goal green, the car blue. Edges are smooth, so that part of a pixel counts."""
        pixel = 2 * ARENA / min(space.height, space.width)
        across = (np.arange(space.width) + 0.5) * (2 * ARENA / space.width) - ARENA
        up = ARENA - (np.arange(space.height) + 0.5)[:, None] * (2 * ARENA / space.height)
        picture = np.full((space.height, space.width, 3), _GROUND)
        for (x, y), radius, colour in ((_LAYOUT.goal, GOAL_RADIUS, _GOAL), (self.position, _CAR_RADIUS, _CAR)):
            away = np.sqrt((across - x) ** 2 + (up - y) ** 2)
            cover = np.clip((radius - away) / pixel + 0.5, 0.0, 1.0)[..., None]
            picture += cover * (np.array(colour) - picture)
        rounded: Pixels = np.rint(picture).astype(np.uint8)
        return rounded

    def render(self) -> Pixels | None:
        """The arena from above, uint8 [320, 320, 3] RGB; None without a render mode."""
        return None if self.render_mode is None else self.frame(_FOR_PEOPLE)

    def _save(self) -> State:
        return {"position": list(self.position), "velocity": list(self.velocity)}

    def _restore(self, state: State) -> None:
        (x, y), (vx, vy) = state["position"], state["velocity"]
        self.position, self.velocity = (float(x), float(y)), (float(vx), float(vy))
