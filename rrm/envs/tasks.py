"""The one place that says what each task is and what the named features of its observations are.

A feature is a position in metres (`hand`, `object`, `goal`; `object_start`, where the object was when the episode
began), what a robot that looks at pictures knows of itself besides (`proprioception`), the uprightness of the torso
(`upright`, the z component of its z axis, in [-1, 1]) or a distance (`clearance`, metres to the nearest obstacle's
edge); a task may have others.
Priors ask for features by name: nobody else indexes an observation.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, Literal

from rrm.envs.panda.physics import Physics
from rrm.envs.spaces import FrameSpace, Spaces
from rrm.errors import ConfigError, UnknownNameError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rrm.envs.base import TaskEnv
    from rrm.types import Floats

#: From where to where a quantity is drawn, by its name in `Task.physics`.
Ranges = Mapping[str, tuple[float, float]]

ScoreKind = Literal["success", "return"]

#: The suite whose tasks an arm does.
ARM = "panda"

#: Where a feature stands in the observation, or how it follows from it.
Feature = slice | Callable[["Floats"], Any]


@dataclass(frozen=True, kw_only=True)
class Task:
    """What planning, priors and reports need to know of a task without starting its simulator."""

    name: str  #: as on the command line
    suite: str  #: "metaworld", "dmc", "panda" or "toy"; "-image" behind it: a camera shows what the state does not
    score: ScoreKind  #: what the paper reports for it: success rate, or true return
    horizon: int  #: steps of an episode
    spaces: Spaces
    entry_point: str  #: dotted path of the environment's class
    kwargs: Mapping[str, str] = field(default_factory=dict)  #: arguments of that class
    packages: tuple[str, ...] = ("gymnasium",)  #: distributions that its simulator is made of
    extra: str | None = None  #: of ours, that brings those beyond what we always need
    physics: Physics | None = None  #: what its simulation is like, where a run may have it vary
    features: Mapping[str, Feature] = field(default_factory=dict)  #: what a prior may ask of an observation, by name
    outcomes: tuple[str, ...] = ()  #: physical quantities after a step, in its `info`, that a prior may read
    views: tuple[str, ...] = ()  #: cameras there are, where it has any
    expert: str | None = None  #: the task whose oracle shows how this one is done, where that is another

    @property
    def env_id(self) -> str:
        """The gymnasium id under which the task is registered."""
        return f"rrm/{self.name}-v0"

    @property
    def needs_opengl(self) -> bool:
        """Whether its pictures are MuJoCo's."""
        return self.spaces.frames is not None and "mujoco" in self.packages

    @property
    def reveals(self) -> tuple[str, ...]:
        """What a prior may ask for: the features, and `success` where the task has such a criterion."""
        return (*self.features, "success") if self.score == "success" else tuple(self.features)

    def feature(self, name: str, obs: Floats) -> npt.NDArray[np.float64]:
        """The numbers of a feature in an observation, a copy; a `KeyError` where there is no such feature."""
        where = self.features[name]
        value = obs[where] if isinstance(where, slice) else where(obs)
        numbers: npt.NDArray[np.float64] = value.astype("float64")
        return numbers


_HAND_OBJECT_GOAL = {"hand": slice(0, 3), "object": slice(4, 7), "goal": slice(36, 39)}


def _metaworld(name: str) -> Task:
    return Task(
        name=name, suite="metaworld", score="success", horizon=500, spaces=Spaces(39, 4),
        entry_point="rrm.envs.metaworld:MetaWorldEnv", kwargs={"task": f"{name}-v3"}, features=_HAND_OBJECT_GOAL,
        packages=("metaworld", "mujoco", "gymnasium"),
    )  # fmt: skip


#: What a robot knows beside pictures (appendix "Image-based RRM"): not where the object is now.
_KNOWN = {"hand": slice(0, 3), "proprioception": slice(0, 4), "object_start": slice(4, 7), "goal": slice(7, 10)}
_CORNERS = ("corner", "corner2", "corner3", "corner4")


def _metaworld_image(name: str) -> Task:
    return replace(
        _metaworld(name), name=f"{name}-image", suite="metaworld-image", expert=name, features=_KNOWN,
        entry_point="rrm.envs.metaworld:MetaWorldImageEnv", views=(*_CORNERS, "topview", "behindGripper", "gripperPOV"),
        spaces=Spaces(10, 4, FrameSpace(64, 64, stack=3, view="corner4")),
    )  # fmt: skip


def _dmc(name: str, spaces: Spaces, upright: int, outcomes: tuple[str, ...]) -> Task:
    domain, _, task_name = name.partition("-")
    return Task(
        name=name, suite="dmc", score="return", horizon=1000, spaces=spaces,
        entry_point="rrm.envs.dmc:DmcEnv", kwargs={"domain": domain, "task": task_name},
        features={"upright": slice(upright, upright + 1)}, outcomes=outcomes,
        packages=("dm-control", "mujoco", "gymnasium"),
    )  # fmt: skip


def _panda(name: str, spaces: Spaces, features: Mapping[str, Feature]) -> Task:
    return Task(
        name=f"{ARM}-{name}", suite=ARM, score="success", horizon=100, spaces=spaces,
        entry_point="rrm.envs.panda.env:PandaEnv", kwargs={"task": name}, features=features,
        packages=("pybullet", "gymnasium"), extra="robot", physics=Physics(),
    )  # fmt: skip


_TOY_CAR = Task(
    name="toy-car", suite="toy", score="success", horizon=100, spaces=Spaces(15, 2),
    entry_point="rrm.envs.toy_car:ToyCarEnv",
    # The car is what moves and what is to be moved: "hand" and "object" are its position.
    features={"hand": slice(0, 2), "object": slice(0, 2), "goal": slice(2, 4), "clearance": slice(4, 5)},
)  # fmt: skip

_TOY_CAR_IMAGE = Task(
    name="toy-car-image", suite="toy-image", score="success", horizon=100, views=("above",),
    spaces=Spaces(6, 2, FrameSpace(32, 32, stack=3, view="above")), entry_point="rrm.envs.toy_car_image:ToyCarImageEnv",
    features={"hand": slice(0, 2), "object": slice(0, 2), "proprioception": slice(0, 4), "goal": slice(4, 6)},
)  # fmt: skip

#: Every task, by its name on the command line.
TASKS: dict[str, Task] = {
    t.name: t
    for t in (
        *map(_metaworld, ("button-press", "door-open", "door-unlock", "sweep-into", "window-open")),
        _dmc("walker-walk", Spaces(24, 6), upright=0, outcomes=("torso_upright", "torso_height", "forward_velocity")),
        _dmc("quadruped-walk", Spaces(78, 12), upright=47, outcomes=("torso_upright", "forward_velocity")),
        _panda("reach", Spaces(6, 3), {"hand": slice(0, 3), "object": slice(3, 6), "goal": slice(3, 6)}),
        _panda("push", Spaces(7, 2), {"hand": slice(0, 2), "object": slice(2, 4), "goal": slice(5, 7)}),
        _panda("pick-and-reach", Spaces(10, 3), {"hand": slice(0, 3), "object": slice(3, 6), "goal": slice(7, 10)}),
        _TOY_CAR,
        *map(_metaworld_image, ("button-press", "sweep-into")),
        _TOY_CAR_IMAGE,
    )
}


def task(name: str) -> Task:
    """The task of this name; an `UnknownNameError`, which suggests the nearest, where there is none."""
    try:
        return TASKS[name]
    except KeyError:
        raise UnknownNameError("task", name, TASKS) from None


def require(spec: Task) -> None:
    """A `ConfigError`, with the command that mends it, where what the task's simulator is made of is not installed."""
    for package in spec.packages:
        try:
            version(package)
        except PackageNotFoundError:
            what = "rrmctl" if spec.extra is None else f"rrmctl[{spec.extra}]"
            missing = f"{spec.name} needs {package}, which is not installed{wheels(package)}"
            raise ConfigError(f"{missing}: pip install '{what}'") from None


def can_vary(spec: Task, ranges: Ranges) -> None:
    """A `ConfigError` where the task's simulation has not what `ranges` would draw."""
    for name in ranges:
        if not hasattr(spec.physics, name):
            those = ", ".join(each.name for each in TASKS.values() if hasattr(each.physics, name)) or "none"
            raise ConfigError(f"env.{name}: {spec.name} has none that could vary; these have: {those}")


def wheels(package: str, python: tuple[int, int] = sys.version_info[:2]) -> str:
    """What to know before it is installed into this Python: nothing, or that pip would have to compile it."""
    if package != "pybullet" or python < (3, 12):
        return ""
    return f" (it has no wheel for Python {python[0]}.{python[1]}, for 3.11 it has)"


def make(
    name: str, horizon: int | None = None, ranges: Ranges | None = None, render_mode: str | None = None
) -> TaskEnv:
    """A fresh environment of the task, ready for `reset(seed=...)`; its simulator is imported now.

    Args:
        name: of the task.
        horizon: steps of an episode where it is to be shorter than the task's own; a `ConfigError` beyond that.
        ranges: from where to where each of these is drawn at every reset, of a task that has `physics`.
        render_mode: "rgb_array" for an environment whose `render()` gives a picture for people, uint8 [H, W, 3].

    Raises ConfigError where the simulator is not installed, or has not what is to be drawn.
    """
    spec = task(name)
    if horizon is not None and not 1 <= horizon <= spec.horizon:
        raise ConfigError(f"horizon is {horizon}; an episode of {name} has between 1 and {spec.horizon} steps")
    can_vary(spec, ranges or {})
    require(spec)
    module, _, attribute = spec.entry_point.partition(":")
    drawn = {"ranges": ranges} if ranges else {}
    environment: TaskEnv = getattr(importlib.import_module(module), attribute)(
        **spec.kwargs, horizon=horizon or spec.horizon, render_mode=render_mode, **drawn
    )
    return environment
