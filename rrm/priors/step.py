"""What a prior may look at: named features of the state, the action, and the outcome of the step.

A prior asks for `step.hand` or `step.goal`, never for entries of the observation, so one prior serves every task that
reveals what it reads. The true reward is not here.

Somebody else wrote it: `evaluate_prior` calls it, and says clearly what went wrong with it.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import takewhile
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rrm.envs.tasks import Task
from rrm.errors import PriorError

if TYPE_CHECKING:
    from rrm.types import Floats, Pixels

Position = npt.NDArray[np.float64]

_LARGEST = 3.4e38  # of a float32
_GUARDS = str(Path(__file__).with_name("language") / "guards.py")  # stand between a model's code and its arithmetic


@dataclass(frozen=True, slots=True)
class Scene:
    """One state of a task, seen through the features the task reveals; others raise `PriorError`."""

    task: Task
    obs: Floats  #: float32 [O], as the agent sees it

    @property
    def hand(self) -> Position:
        """Where the hand (the car) is, metres."""
        return self.feature("hand")

    @property
    def object(self) -> Position:
        """Where the object to be moved is (the car itself on toy-car), metres."""
        return self.feature("object")

    @property
    def object_start(self) -> Position:
        """Where the object was when the episode began, metres."""
        return self.feature("object_start")

    @property
    def goal(self) -> Position:
        """Where the object is to go, metres."""
        return self.feature("goal")

    @property
    def upright(self) -> float:
        """The z component of the torso's z axis, in [-1, 1]; 1 is upright."""
        return float(self.feature("upright")[0])

    @property
    def clearance(self) -> float:
        """Metres to the edge of the nearest obstacle, at least 0."""
        return float(self.feature("clearance")[0])

    def reveals(self, name: str) -> bool:
        """Whether the task has this feature, for priors that can do with another."""
        return name in self.task.reveals

    def feature(self, name: str) -> Position:
        """The feature's numbers, float64, a copy."""
        try:
            return self.task.feature(name, self.obs)
        except KeyError:
            raise PriorError(
                f'{self.task.name} does not reveal "{name}"; it reveals: {", ".join(self.task.reveals)}'
            ) from None


@dataclass(frozen=True, slots=True)
class PriorStep(Scene):
    """One step (s_t, a_t). Features and `obs` are of s_t, before the step; the rest is its outcome."""

    act: Floats  #: float32 [A], in [-1, 1]
    info: Mapping[str, float]  #: of the environment's step
    rng: np.random.Generator  #: for priors that draw; its state is saved with the run
    first: Scene  #: the state the episode began with
    frames: Pixels | None = None  #: what an agent that sees frames saw of s_t, [stack, channels, height, width]

    @property
    def success(self) -> float:
        """1.0 where this step met the task's success criterion, else 0.0."""
        if self.task.score != "success":
            raise PriorError(f'{self.task.name} has no "success"; it reveals: {", ".join(self.task.reveals)}')
        return float(self.info["success"])

    @property
    def torso_upright(self) -> float:
        """The z component of the torso's z axis after the step, in [-1, 1]."""
        return self._outcome("torso_upright")

    @property
    def torso_height(self) -> float:
        """Of the torso after the step, metres."""
        return self._outcome("torso_height")

    @property
    def forward_velocity(self) -> float:
        """After the step, m/s: the walker's centre of mass along x, the quadruped's torso along its own x axis."""
        return self._outcome("forward_velocity")

    def _outcome(self, name: str) -> float:
        if name not in self.task.outcomes:
            there = ", ".join(self.task.outcomes) or "none"
            raise PriorError(f'{self.task.name} does not tell "{name}" of a step; what it tells: {there}')
        return float(self.info[name])


def evaluate_prior(prior: Callable[[PriorStep], float], step: PriorStep, where: str) -> float:
    """The prior's value of this step; `where` says which, for messages, such as `prior "proxy" at step 17`.

    A `PriorError`, with its cause, where the prior raised, or returned something other than one finite number.
    """
    try:
        value: Any = prior(step)
    except PriorError as error:
        raise PriorError(f"{where}: {error}") from error
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)[1:]
        theirs = list(takewhile(lambda frame: frame.filename != _GUARDS, frames))
        line = f" ({theirs[-1].filename}, line {theirs[-1].lineno})" if theirs else ""
        raise PriorError(f"{where} raised {type(error).__name__}: {error}{line}") from error
    shape = getattr(value, "shape", None)
    number = value.item() if shape == () else value  # a numpy scalar, or an array without axes
    if not isinstance(number, Real):
        kind = type(value).__name__ if shape is None else f"{type(value).__name__} of shape {tuple(shape)}"
        text = " ".join(repr(value).split())  # arrays are printed over several lines
        shown = f"{text if len(text) <= 60 else text[:57] + '...'} ({kind})"
        raise PriorError(f"{where} returned {shown}; a prior returns one number per step")
    number = float(number)
    if not abs(number) <= _LARGEST:
        raise PriorError(f"{where} returned {number}; a prior returns a finite number that fits into a float32")
    return number
