"""A small car that drives around obstacles to a goal: the paper's appendix example ("A toy example ..."), made real.

The paper gives the prior (-1 within 0.1 m of an obstacle, 10 within 0.5 m of the goal) and says what it leaves out: to
go fast, to pass obstacles at a safe speed and not to lose speed. The rest, the car and the true reward, is ours.

The arena is a square of 5 m with three round obstacles of radius 0.3 m. At every reset a direction is drawn; the car
starts 1.75 to 2 m from the centre on one side, looking anywhere, and the goal lies as far on the other. One obstacle
stands across the straight way, one on either side of it.

Dynamics, in steps of 0.1 s, for an action (throttle a, steering w), each in [-1, 1]; speed v (m/s), heading h (rad):

    v <- 0.8 v + 0.3 a                  top speed 1.5 m/s, also backwards
    h <- h + 0.25 w
    (x, y) <- (x, y) + 0.1 v (cos h, sin h)

An obstacle or the edge of the arena stops the car: it is put back onto the edge with v = 0.

True reward per step, in [-1.5, 1], from the state after it, with d the distance to the goal and c the clearance, i.e.
the distance to the nearest obstacle's edge (metres):

    r = [d < 0.5] - [d >= 0.5] min(d / 5, 1) ... arrive early, and stay
        - 0.25 [c < 0.1]                     ... keep off the obstacles
        - 0.25 (v / 1.5)^2 max(0, 1 - c/0.4) ... and be slow near them

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
TOP_SPEED = 1.5  #: m/s
_STEP_S = 0.1
_PIXELS = 320  #: side of a rendered frame

Point = tuple[float, float]


class Layout(NamedTuple):
    """What a reset draws, apart from the car."""

    goal: Point
    obstacles: tuple[Point, Point, Point]


class ToyCarEnv(TaskEnv):
    """The car. Distances in metres, speed in m/s; `observe` says what stands where in the 16 numbers.

    Args:
        horizon: steps of an episode.
        render_mode: "rgb_array" for frames of 320 x 320 pixels from above, or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  (gymnasium declares it so)

    def __init__(self, horizon: int = 100, render_mode: str | None = None) -> None:
        across = 2 * ARENA * math.sqrt(2)  # no two points of the arena are further apart
        high = [ARENA] * 4 + [across, 1.0, 1.0, 1.01 * TOP_SPEED] + [across] * 8
        low = [-bound for bound in high]
        super().__init__(low, high, obs_dim=16, act_dim=2, horizon=horizon, render_mode=render_mode)
        self.layout = Layout((0.0, 0.0), ((0.0, 0.0),) * 3)
        self.x = self.y = self.heading = self.speed = 0.0

    def _begin(self) -> list[float]:
        self.layout, (self.x, self.y), self.heading = draw(self.np_random)
        self.speed = 0.0
        return self._observation()

    def _advance(self, action: Doubles) -> tuple[list[float], float, dict[str, float]]:
        self.speed = 0.8 * self.speed + 0.3 * float(action[0])
        self.heading = math.remainder(self.heading + 0.25 * float(action[1]), math.tau)
        x = self.x + _STEP_S * self.speed * math.cos(self.heading)
        y = self.y + _STEP_S * self.speed * math.sin(self.heading)
        self.x, self.y = _outside(x, y, self.layout.obstacles)
        if (self.x, self.y) != (x, y):
            self.speed = 0.0
        distance = math.dist((self.x, self.y), self.layout.goal)
        reward = true_reward(distance, clearance((self.x, self.y), self.layout.obstacles), self.speed)
        return self._observation(), reward, {"success": float(distance < GOAL_RADIUS)}

    def _observation(self) -> list[float]:
        return observe(self.layout, (self.x, self.y), self.heading, self.speed)

    def _save(self) -> State:
        return {
            "goal": list(self.layout.goal),
            "obstacles": [list(centre) for centre in self.layout.obstacles],
            "car": [self.x, self.y, self.heading, self.speed],
        }

    def _restore(self, state: State) -> None:
        first, second, third = ((float(x), float(y)) for x, y in state["obstacles"])
        x, y = state["goal"]
        self.layout = Layout((float(x), float(y)), (first, second, third))
        self.x, self.y, self.heading, self.speed = (float(value) for value in state["car"])

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The arena from above, uint8 [320, 320, 3] RGB; None without a render mode."""
        if self.render_mode is None:
            return None
        return _draw_frame(self.layout, (self.x, self.y), self.heading)


def draw(rng: np.random.Generator) -> tuple[Layout, Point, float]:
    """A layout, the car's start and its heading. The number of draws is the same whatever comes out."""
    turn, spread, away, off, heading = rng.uniform(
        (-math.pi, -0.3, 1.75, 1.75, -math.pi), (math.pi, 0.3, 2.0, 2.0, math.pi)
    )
    start = (-away * math.cos(turn), -away * math.sin(turn))
    goal = (off * math.cos(turn + spread), off * math.sin(turn + spread))
    # Along the way from start (0) to goal (1), and metres to its left; all are 1 m or more from both.
    along = rng.uniform(0.35, 0.65, size=3)
    aside = rng.uniform((-0.25, 0.8, -1.2), (0.25, 1.2, -0.8))
    obstacles = tuple(_beside(start, goal, float(t), float(s)) for t, s in zip(along, aside, strict=True))
    first, second, third = obstacles
    return (
        Layout((float(goal[0]), float(goal[1])), (first, second, third)),
        (float(start[0]), float(start[1])),
        float(heading),
    )


def _beside(start: Point, goal: Point, along: float, aside: float) -> Point:
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    length = math.hypot(dx, dy)
    return (
        float(start[0] + along * dx - aside * dy / length),
        float(start[1] + along * dy + aside * dx / length),
    )


def observe(layout: Layout, car: Point, heading: float, speed: float) -> list[float]:
    """The 16 numbers the agent sees.

    0:2 the car, 2:4 the goal, 4 the clearance, 5:7 (cos, sin) of the heading, 7 the speed, 8:10 the goal and 10:16 the
    three obstacles' centres, nearest first, as seen from the car (metres ahead, metres to the left).
    """
    x, y = car
    cos, sin = math.cos(heading), math.sin(heading)
    seen = []
    for px, py in layout.obstacles:
        dx, dy = px - x, py - y
        seen.append((dx * dx + dy * dy, cos * dx + sin * dy, cos * dy - sin * dx))
    seen.sort()
    (nearest, *first), (_, *second), (_, *third) = seen
    gx, gy = layout.goal
    dx, dy = gx - x, gy - y
    free = max(0.0, math.sqrt(nearest) - RADIUS)
    return [x, y, gx, gy, free, cos, sin, speed, cos * dx + sin * dy, cos * dy - sin * dx, *first, *second, *third]


def clearance(car: Point, obstacles: tuple[Point, ...]) -> float:
    """Metres from the car to the nearest obstacle's edge, at least 0."""
    return max(0.0, min(math.dist(car, centre) for centre in obstacles) - RADIUS)


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
        if 0.0 < distance < RADIUS:  # the very centre cannot be reached: a step is half a radius long at most
            x, y = px + (x - px) * RADIUS / distance, py + (y - py) * RADIUS / distance
    return min(max(x, -ARENA), ARENA), min(max(y, -ARENA), ARENA)


def _draw_frame(layout: Layout, car: Point, heading: float) -> npt.NDArray[np.uint8]:
    import cv2

    frame = np.full((_PIXELS, _PIXELS, 3), 245, dtype=np.uint8)
    scale = _PIXELS / (2 * ARENA)

    def pixel(point: Point) -> tuple[int, int]:
        return round((point[0] + ARENA) * scale), round((ARENA - point[1]) * scale)

    cv2.circle(frame, pixel(layout.goal), round(GOAL_RADIUS * scale), (170, 220, 170), cv2.FILLED, cv2.LINE_AA)
    for centre in layout.obstacles:
        cv2.circle(frame, pixel(centre), round(RADIUS * scale), (90, 90, 90), cv2.FILLED, cv2.LINE_AA)
    nose = (car[0] + 0.2 * math.cos(heading), car[1] + 0.2 * math.sin(heading))
    cv2.circle(frame, pixel(car), round(0.1 * scale), (60, 90, 200), cv2.FILLED, cv2.LINE_AA)
    cv2.line(frame, pixel(car), pixel(nose), (200, 60, 60), 2, cv2.LINE_AA)
    return frame
