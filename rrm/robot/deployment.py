"""Episodes of a policy at a workplace: it sees what the cameras and the arm say, and nothing of the simulator.

What counts as what:

- An episode succeeds where, at its end, the cube (or, for reaching, the hand) is within 5 cm of the goal, by the
  workplace's truth; what the cameras say of it is recorded beside that.
- Where the cube is lost from sight for too long, the arm stops and the episode has failed, wherever the cube may be. It
  goes on to its last step with the arm at rest, so that all returns are sums over as many steps.
- Where the workplace breaks down, the episode is played again from its beginning at a new one, as the policy had no
  part in that; three breakdowns in one episode end the deployment.
- A policy whose action is not finite ends the deployment: the arm stops, and `NumericalError` says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rrm.envs.panda.physics import Pose
from rrm.envs.panda.rules import NEAR, RULES, Rules
from rrm.envs.tasks import ARM
from rrm.errors import ConfigError, NumericalError, PerceptionError, RobotError
from rrm.robot.perception import Sight, Tracker, check_cameras
from rrm.seeding import evaluation_seed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rrm.envs.panda.physics import Vector
    from rrm.robot.camera import Camera
    from rrm.robot.interface import Workplace
    from rrm.robot.markers import MarkedCube
    from rrm.types import Floats

Policy = Callable[["Floats"], "Floats"]

#: Workplaces that may break down in one episode before that ends the deployment.
_BREAKDOWNS = 3


@dataclass(frozen=True, kw_only=True)
class Episode:
    """What came of one."""

    number: int
    success: bool  #: by the truth, where there is one; False where the cube was lost from sight
    success_seen: bool  #: by the cameras
    total: float  #: true reward, summed over all steps: by the truth, where there is one
    total_seen: float  #: by the cameras
    steps: int  #: all of them
    acted: int  #: steps until the cube was lost from sight; `steps` where it was not
    views: float  #: cameras that saw it, mean over the frames that counted
    markers: float  #: markers in them together, mean
    error_px: float  #: reprojection error, mean
    held: int  #: frames for which the last estimate stood in
    breakdowns: int  #: of the workplace, in this episode, before it was played to its end
    lost: str = ""  #: why the cube was lost from sight, where it was


def rules_of(task: str) -> Rules:
    """Of a task that an arm can do; a `ConfigError` for others."""
    name = task.removeprefix(f"{ARM}-")
    if name == task or name not in RULES:
        there = ", ".join(f"{ARM}-{name}" for name in RULES)
        raise ConfigError(f"a policy of {task} has nothing to do at an arm; those of {there} have")
    return RULES[name]


def deploy(
    policy: Policy,
    task: str,
    connect: Callable[[], Workplace],
    cameras: Mapping[str, Camera],
    cube: MarkedCube,
    *,
    episodes: int,
    seed: int,
    first: int = 0,
    horizon: int = 100,
    patience: int = 20,
) -> Iterator[Episode]:
    """Play episodes, one by one; each follows from the seed and its number alone. However it is left, the arm stops.

    Args:
        policy: the action, float32 [A] in [-1, 1], for an observation float32 [O] of the task.
        task: by its name.
        connect: makes a workplace; called again where one has broken down.
        cameras: as calibrated.
        cube: the one that lies there.
        episodes: the number after the last.
        seed: of the instances.
        first: the number of the first, where earlier ones are there already.
        horizon: steps of each.
        patience: frames in a row without sight of the cube, after which it is lost.

    Raises:
        ConfigError: the task is none of an arm's.
        CalibrationError: it is not of the workplace's cameras.
        NumericalError: the policy's action is not finite.
        RobotError: the workplace breaks down again and again.
    """
    rules, tracker = rules_of(task), Tracker(cameras, cube, patience=patience)
    place: Workplace | None = None
    number, breakdowns = first, 0
    try:
        while number < episodes:
            try:
                place = place or connect()
                check_cameras(place.sizes, cameras)
                goal = place.begin(task, evaluation_seed(seed, 0, number))
                played = _Play(policy, rules, place, tracker, goal).episode(number, horizon, breakdowns)
            except RobotError as error:
                _leave(place)
                place, breakdowns = None, breakdowns + 1
                if breakdowns == _BREAKDOWNS:
                    raise RobotError(f"episode {number}, {breakdowns} times in a row: {error}") from error
                continue
            yield played
            number, breakdowns = number + 1, 0
    finally:
        _leave(place)


def _leave(place: Workplace | None) -> None:
    """The arm stands still, and the workplace is closed."""
    if place is not None:
        place.stop()
        place.close()


class _Play:
    """One episode under way."""

    def __init__(self, policy: Policy, rules: Rules, robot: Workplace, tracker: Tracker, goal: Vector) -> None:
        self._policy, self._rules, self._robot, self._tracker, self._goal = policy, rules, robot, tracker, goal
        self._closed = not rules.picks
        self._seen: list[Sight] = []
        self._lost = ""

    def episode(self, number: int, horizon: int, breakdowns: int) -> Episode:
        robot, acted, total = self._robot, 0, 0.0
        self._tracker.forget()
        sight = self._look()
        while sight is None and not self._lost:  # at rest
            if robot.truth() is None:
                robot.wait()  # for other pictures; at the simulated rig time stands still, and noise is each look's own
            sight = self._look()
        for _ in range(horizon):
            if sight is not None and not self._lost:
                self._act(sight)
                acted += 1
            robot.wait()
            sight = self._look() or sight
            total += self._reward(sight)
        robot.stop()
        truth = robot.truth()
        seen = sight is not None and not self._lost and self._distance(sight) < NEAR
        fresh = [sight for sight in self._seen if sight.age == 0]
        views, markers, error = (
            float(np.mean([getattr(sight, name) for sight in fresh])) if fresh else float("nan")
            for name in ("views", "markers", "error_px")
        )
        return Episode(
            number=number, success=not self._lost and (seen if truth is None else truth.success), success_seen=seen,
            total=total if truth is None else truth.total, total_seen=total, steps=horizon, acted=acted,
            views=views, markers=markers, error_px=error, held=len(self._seen) - len(fresh), breakdowns=breakdowns,
            lost=self._lost,
        )  # fmt: skip

    def _look(self) -> Sight | None:
        """Where the cube is; the arm stops, for the rest of the episode, where that is no longer known."""
        if self._lost:
            return None
        try:
            sight = self._tracker.look(self._robot.images())
        except PerceptionError as error:
            self._robot.stop()
            self._lost = str(error)
            return None
        if sight is not None:
            self._seen.append(sight)
        return sight

    def _act(self, sight: Sight) -> None:
        """The policy's action, on what is seen."""
        hand = self._robot.state().hand
        obs = np.array(self._rules.observe(hand, Pose(sight.position, sight.yaw), self._goal), np.float32)
        action = np.asarray(self._policy(obs), float)
        if action.shape != (self._rules.dims,):
            raise ConfigError(f"the policy's action has shape {action.shape}, this task's has ({self._rules.dims},)")
        if not np.isfinite(action).all():
            self._robot.stop()
            raise NumericalError(f"the policy's action {action.tolist()} is not finite: the arm has stopped")
        self._closed = self._rules.closed(hand, sight.position, self._closed)
        self._robot.move(self._rules.velocity(np.clip(action, -1.0, 1.0).tolist()), closed=self._closed)

    def _reward(self, sight: Sight | None) -> float:
        """The true reward, by what was seen last; NaN where nothing ever was."""
        if sight is None:
            return float("nan")
        return self._rules.reward(self._robot.state().hand, sight.position, self._goal_by(sight))

    def _distance(self, sight: Sight) -> float:
        return self._rules.left(self._robot.state().hand, sight.position, self._goal_by(sight))

    def _goal_by(self, sight: Sight) -> Vector:
        """The goal, which for reaching is the cube."""
        return self._goal if self._rules.moves else sight.position
