"""The three tasks of the paper's arm (section "Real robot", appendix "Sim-to-real environments"): what an instance is,
what an agent sees and commands, the true rewards, success. The same in a simulation and at an arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rrm.envs.panda.physics import TIP, Limits, Physics, Pose, Vector, lying

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

SPEED = 0.2  #: m/s along each axis, of an action of 1
NEAR = 0.05  #: metres: success

Area = tuple[tuple[float, float], tuple[float, float]]  #: from the lowest x and y to the highest

_TABLE: Area = (0.44, -0.15), (0.58, 0.15)
_APART = 0.1  # metres at least, of cube and goal
_AIR = 0.10, 0.25  # heights of a goal that a cube is carried to
_CLEAR = 0.005  # of the fingers' tips above a cube that is not to be touched
_CLOSES, _OPENS = 0.015, 0.04  # metres from the hand to the cube's centre


@dataclass(frozen=True, slots=True)
class Rules:
    """One of the tasks."""

    start: Vector  #: the hand's
    cubes: Area = _TABLE  #: where the cube's centre may lie at the start
    goals: Area = _TABLE  #: likewise the goal, apart from it
    dims: int = 3  #: of what is seen and commanded: x, y and z, or x and y at the height of the start
    moves: bool = True  #: the cube is to be moved to a goal; else it is the goal itself, and is not touched
    picks: bool = False  #: with fingers that grip; else they stay closed

    def limits(self, physics: Physics) -> Limits:
        """Of the hand."""
        usual = Limits()
        floor, ceiling = usual.low[2], usual.high[2]
        if self.dims == 2:
            floor = ceiling = self.start[2]
        elif not self.moves:
            floor = physics.cube_size + TIP + _CLEAR
        return Limits((*usual.low[:2], floor), (*usual.high[:2], ceiling), usual.margin)

    def draw(self, rng: np.random.Generator, physics: Physics) -> tuple[Pose, Vector]:
        """Where cube and goal of an episode are."""
        turn = math.radians(15 if self.picks else 45)  # the hand does not turn, and opens no wider than 8 cm
        (x, y), yaw = rng.uniform(*self.cubes).tolist(), float(rng.uniform(-turn, turn))
        cube = lying(x, y, yaw, physics)
        goal = cube.position
        while self.moves and math.dist(goal, cube.position) < _APART:
            x, y = rng.uniform(*self.goals).tolist()
            goal = (x, y, float(rng.uniform(*_AIR)) if self.picks else cube.position[2])
        return cube, goal

    def velocity(self, action: Sequence[float]) -> Vector:
        """What an action in [-1, 1] commands the hand."""
        x, y, z = (SPEED * float(part) for part in (*action, 0.0)[:3])
        return x, y, z

    def observe(self, hand: Vector, cube: Pose, goal: Vector) -> list[float]:
        """The numbers an agent sees; `rrm.envs.tasks` has their places."""
        end = self.dims
        seen = [*hand[:end], *cube.position[:end]]
        return [*seen, cube.yaw, *goal[:end]] if self.moves else seen

    def reward(self, hand: Vector, cube: Vector, goal: Vector) -> float:
        """The true reward: -|hand - cube| for reaching, in [0, 4] where the cube is moved."""
        to_cube = math.dist(hand[: self.dims], cube[: self.dims])
        if not self.moves:
            return -to_cube
        return 3 * (1 - math.tanh(10 * self.left(hand, cube, goal))) + (1 - math.tanh(10 * to_cube))

    def left(self, hand: Vector, cube: Vector, goal: Vector) -> float:
        """Metres from the cube to the goal, or from the hand to the cube; below `NEAR` is success."""
        return math.dist((cube if self.moves else hand)[: self.dims], goal[: self.dims])

    def closed(self, hand: Vector, cube: Vector, was: bool) -> bool:
        """Whether the fingers are closed next: they grip what is between them, and open when they have lost it."""
        return not self.picks or math.dist(hand, cube) < (_OPENS if was else _CLOSES)


RULES = {
    "reach": Rules(start=(0.42, 0.0, 0.2), moves=False),
    # The goal lies beyond the cube, as in Meta-World's tasks: the way there is a push, not a walk around the cube.
    "push": Rules(
        start=(0.35, 0.0, 0.03), dims=2, cubes=((0.42, -0.12), (0.50, 0.12)), goals=((0.55, -0.15), (0.63, 0.15))
    ),
    "pick-and-reach": Rules(start=(0.42, 0.0, 0.15), picks=True),
}
