"""The seam to an arm, and what keeps it safe on the arm's side of that seam.

A laboratory implements `Workplace`; `rrm.robot.rig` is one whose arm is simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from rrm.envs.panda.physics import Limits, Vector
from rrm.errors import NumericalError

if TYPE_CHECKING:
    from rrm.types import Pixels

#: Seconds that a command is meant for.
PERIOD_S = 0.05


class ArmState(NamedTuple):
    """What an arm knows of itself."""

    hand: Vector  #: of the point between the fingers in the base frame, metres
    opening: float  #: between the fingers, metres


class Truth(NamedTuple):
    """What somebody who is no camera says of an episode so far."""

    success: bool  #: now
    total: float  #: true reward since it began


class Robot(Protocol):
    """An arm with a gripper and cameras. What is lost for good raises `RobotError`."""

    sizes: Mapping[str, tuple[int, int]]  #: of the pictures, (width, height) by the camera's name

    def state(self) -> ArmState:
        """As it is now."""

    def move(self, velocity: Vector, *, closed: bool) -> None:
        """Have the hand move, m/s along the base's axes, and the fingers close or open; until the next command, or
        until none has come for a while. Limits are the robot's. `NumericalError`, and the arm stops: not finite.
        """

    def stop(self) -> None:
        """The arm stands still, whatever has happened; it can be called at any moment, and again."""

    def images(self) -> dict[str, Pixels]:
        """The newest pictures, RGB [height, width, 3], by the camera's name."""

    def wait(self) -> None:
        """Until the next command is due: a `PERIOD_S` after the last time."""


class Workplace(Robot, Protocol):
    """A robot with somebody who sets the table."""

    def begin(self, task: str, seed: int) -> Vector:
        """Bring the arm to its start and the cube to a place that follows from the seed; returns the goal, metres."""

    def truth(self) -> Truth | None:
        """How the episode stands; None where nobody knows better than the cameras."""

    def close(self) -> None:
        """Leave, the arm at rest."""


@dataclass(frozen=True, kw_only=True)
class Guard:
    """What an arm lets through of the velocities that it is told."""

    speed: float  #: m/s at most
    watchdog_s: float  #: it stops where no command came for longer

    def allowed(self, velocity: Vector, hand: Vector, limits: Limits) -> Vector:
        """The velocity, slowed down to the limit, and without what would lead out of the box within a period.

        Raises:
            NumericalError: it is not three finite numbers.
        """
        wanted = np.asarray(velocity, float)
        if wanted.shape != (3,) or not np.isfinite(wanted).all():
            raise NumericalError(f"a velocity of {wanted.tolist()} m/s was commanded: the arm stops")
        wanted *= min(1.0, self.speed / max(float(np.linalg.norm(wanted)), 1e-9))
        low, high = (np.subtract(bound, hand) / PERIOD_S for bound in (limits.low, limits.high))
        x, y, z = np.minimum(np.maximum(wanted, np.minimum(low, 0.0)), np.maximum(high, 0.0)).tolist()
        return x, y, z

    def expired(self, silent_s: float) -> bool:
        """Whether the arm stops, after so many seconds without a command."""
        return silent_s > self.watchdog_s + 1e-9
