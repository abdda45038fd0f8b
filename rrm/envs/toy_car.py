"""A small car that drives around obstacles to a goal: the paper's appendix example ("A toy example ..."), made real.

The paper gives the prior (-1 within 0.1 m of an obstacle, 10 within 0.5 m of the goal) and says what it leaves out: to
go fast, to pass obstacles at a safe speed and not to lose speed. The rest, the car and the true reward, is ours.

The arena is a square of 5 m with three round obstacles of radius 0.3 m. At every reset a direction is drawn; the car
starts at rest 1.75 to 2 m from the centre on one side, and the goal lies as far on the other. One obstacle stands
across the straight way, one on either side of it.

Dynamics, in steps of 0.1 s, for an action a in [-1, 1] x [-1, 1], the engine's pull along x and y; position p (m),
velocity v (m/s):

    v <- 0.5 v + a                      top speed 2 m/s along either axis
    p <- p + 0.1 v

An obstacle and the edge of the arena cannot be passed: the car is put back onto the edge, and its velocity becomes
what it really covered (no more than the top speed), so a head-on hit stops it and a graze slows it down.

True reward per step, in [-1.75, 1], from the state after it, with d the distance to the goal and c the clearance, i.e.
the distance to the nearest obstacle's edge (metres):

    r = [d < 0.5] - [d >= 0.5] min(d / 5, 1) ... arrive early, and stay
        - 0.25 [c < 0.1]                     ... keep off the obstacles
        - 0.25 |v / 2|^2 max(0, 1 - c/0.4)   ... and be slow near them

Success is d < 0.5 at this step. The episode never terminates; its time limit is 100 steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rrm.envs.base import Doubles, TaskEnv
from rrm.types import State

ARENA = 2.5  #: half the side of the square, metres; its centre is the origin
RADIUS = 0.3  #: of every obstacle, metres
GOAL_RADIUS = 0.5  #: metres; closer counts as success
DANGER = 0.1  #: metres of clearance below which the car is too close to an obstacle
CAUTION = 0.4  #: metres of clearance below which speed costs
TOP_SPEED = 2.0  #: m/s, along either axis
_STEP_S = 0.1
_PIXELS = 320  #: side of a rendered frame

Point = tuple[float, float]


class Layout(NamedTuple):
    """What a reset draws, apart from the car."""

    goal: Point
    obstacles: tuple[Point, Point, Point]


class ToyCarEnv(TaskEnv):
    """The car. Distances in metres, speed in m/s; `observe` says what stands where in the 15 numbers.

    Args:
        horizon: steps of an episode.
        render_mode: "rgb_array" for frames of 320 x 320 pixels from above, or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  (gymnasium declares it so)

    def __init__(self, horizon: int = 100, render_mode: str | None = None) -> None:
        across = 2 * ARENA * math.sqrt(2)  # no two points of the arena are further apart
        high = [ARENA] * 4 + [across] + [TOP_SPEED] * 2 + [across] * 8
        low = [-bound for bound in high]
        super().__init__(low, high, obs_dim=15, act_dim=2, horizon=horizon, render_mode=render_mode)
        self.layout = Layout((0.0, 0.0), ((0.0, 0.0),) * 3)
        self.position: Point = (0.0, 0.0)
        self.velocity: Point = (0.0, 0.0)

    def _begin(self) -> list[float]:
        self.layout, self.position = draw(self.np_random)
        self.velocity = (0.0, 0.0)
        return observe(self.layout, self.position, self.velocity)

    def _advance(self, action: Doubles) -> tuple[list[float], float, dict[str, float]]:
        self.position, self.velocity = drive(
            self.layout, self.position, self.velocity, (float(action[0]), float(action[1]))
        )
        distance = math.dist(self.position, self.layout.goal)
        free = clearance(self.position, self.layout.obstacles)
        reward = true_reward(distance, free, math.hypot(*self.velocity))
        obs = observe(self.layout, self.position, self.velocity)
        return obs, reward, {"success": float(distance < GOAL_RADIUS)}

    def _save(self) -> State:
        return {
            "goal": list(self.layout.goal),
            "obstacles": [list(centre) for centre in self.layout.obstacles],
            "position": list(self.position),
            "velocity": list(self.velocity),
        }

    def _restore(self, state: State) -> None:
        first, second, third = (_point(centre) for centre in state["obstacles"])
        self.layout = Layout(_point(state["goal"]), (first, second, third))
        self.position, self.velocity = _point(state["position"]), _point(state["velocity"])

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The arena from above, uint8 [320, 320, 3] RGB; None without a render mode."""
        if self.render_mode is None:
            return None
        return _draw_frame(self.layout, self.position, self.velocity)


def draw(rng: np.random.Generator) -> tuple[Layout, Point]:
    """A layout, and where the car starts. The number of draws is the same whatever comes out."""
    turn, spread, away, off = rng.uniform((-math.pi, -0.3, 1.75, 1.75), (math.pi, 0.3, 2.0, 2.0)).tolist()
    start = (-away * math.cos(turn), -away * math.sin(turn))
    goal = (off * math.cos(turn + spread), off * math.sin(turn + spread))
    # Along the way from start (0) to goal (1), and metres to its left: 1.2 m or more from both, 0.75 m from each other.
    along = rng.uniform(0.35, 0.65, size=3).tolist()
    aside = rng.uniform((-0.25, 1.0, -1.4), (0.25, 1.4, -1.0)).tolist()
    first, second, third = (_beside(start, goal, t, s) for t, s in zip(along, aside, strict=True))
    return Layout(goal, (first, second, third)), start


def _beside(start: Point, goal: Point, along: float, aside: float) -> Point:
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    length = math.hypot(dx, dy)
    return start[0] + along * dx - aside * dy / length, start[1] + along * dy + aside * dx / length


def drive(layout: Layout, position: Point, velocity: Point, action: Point) -> tuple[Point, Point]:
    """Position and velocity after one step."""
    x = position[0] + _STEP_S * (0.5 * velocity[0] + action[0])
    y = position[1] + _STEP_S * (0.5 * velocity[1] + action[1])
    x, y = _outside(x, y, layout.obstacles)
    return (x, y), (_speed(x - position[0]), _speed(y - position[1]))


def _speed(covered: float) -> float:
    return min(max(covered / _STEP_S, -TOP_SPEED), TOP_SPEED)


def observe(layout: Layout, position: Point, velocity: Point) -> list[float]:
    """The 15 numbers the agent sees, metres and m/s.

    0:2 the car, 2:4 the goal, 4 the clearance, 5:7 the velocity, 7:9 the way to the goal, and 9:15 the ways to the
    three obstacles' centres, nearest first.
    """
    x, y = position
    gx, gy = layout.goal
    ways = sorted(((px - x, py - y) for px, py in layout.obstacles), key=_square)
    free = max(0.0, math.hypot(*ways[0]) - RADIUS)
    return [x, y, gx, gy, free, *velocity, gx - x, gy - y, *ways[0], *ways[1], *ways[2]]


def _square(way: Point) -> float:
    return way[0] * way[0] + way[1] * way[1]


def _point(pair: list[float]) -> Point:
    x, y = pair
    return float(x), float(y)


def clearance(position: Point, obstacles: tuple[Point, ...]) -> float:
    """Metres from the car to the nearest obstacle's edge, at least 0."""
    return max(0.0, min(math.dist(position, centre) for centre in obstacles) - RADIUS)


def true_reward(distance: float, free: float, speed: float) -> float:
    """The reward of one step (see the module's docstring) at this distance to the goal, clearance and speed."""
    reward = 1.0 if distance < GOAL_RADIUS else -min(distance / (2 * ARENA), 1.0)
    if free < DANGER:
        reward -= 0.25
    if free < CAUTION:
        reward -= 0.25 * (speed / TOP_SPEED) ** 2 * (1.0 - free / CAUTION)
    return reward


def _outside(x: float, y: float, obstacles: tuple[Point, ...]) -> Point:
    """The point itself, or the nearest one outside every obstacle and inside the arena."""
    for px, py in obstacles:
        distance = math.hypot(x - px, y - py)
        if 0.0 < distance < RADIUS:  # a step is shorter than the radius: it cannot reach the centre
            x, y = px + (x - px) * RADIUS / distance, py + (y - py) * RADIUS / distance
    return min(max(x, -ARENA), ARENA), min(max(y, -ARENA), ARENA)


def _draw_frame(layout: Layout, position: Point, velocity: Point) -> npt.NDArray[np.uint8]:
    import cv2

    frame = np.full((_PIXELS, _PIXELS, 3), 245, dtype=np.uint8)
    scale = _PIXELS / (2 * ARENA)

    def pixel(point: Point) -> tuple[int, int]:
        return round((point[0] + ARENA) * scale), round((ARENA - point[1]) * scale)

    cv2.circle(frame, pixel(layout.goal), round(GOAL_RADIUS * scale), (170, 220, 170), cv2.FILLED, cv2.LINE_AA)
    for centre in layout.obstacles:
        cv2.circle(frame, pixel(centre), round(RADIUS * scale), (90, 90, 90), cv2.FILLED, cv2.LINE_AA)
    ahead = (position[0] + 0.2 * velocity[0], position[1] + 0.2 * velocity[1])
    cv2.circle(frame, pixel(position), round(0.1 * scale), (60, 90, 200), cv2.FILLED, cv2.LINE_AA)
    cv2.line(frame, pixel(position), pixel(ahead), (200, 60, 60), 2, cv2.LINE_AA)
    return frame
