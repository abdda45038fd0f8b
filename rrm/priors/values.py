"""The prior value of each transition, computed and scaled once, while the transition is collected.

It keeps what it was given then; nothing is scaled anew later. The appendix divides by the running standard deviation
where that exceeds 1, and never shifts: a shift is invisible to preferences over segments of equal length, and enlarging
a small prior could carry it beyond the residual's reach. The main text writes a z-score. Both update with the new value
first and then apply.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from rrm.envs.tasks import Task
from rrm.moments import RunningMoments
from rrm.priors.step import PriorStep, Scene, evaluate_prior
from rrm.types import Floats, Obs, State

_EPSILON = 1e-8  # of the z-score; the paper names it and gives no value


def scaled(raw: float, seen: RunningMoments, normaliser: Literal["scale", "zscore"]) -> float:
    """Over max(1, sigma), the appendix' "scale", or (x - mu) / (sigma + epsilon), the main text's "zscore"."""
    return raw / max(1.0, seen.std) if normaliser == "scale" else (raw - seen.mean) / (seen.std + _EPSILON)


class PriorSource:
    """A prior with its running scale, fed one transition at a time."""

    def __init__(
        self,
        name: str,
        prior: Callable[[PriorStep], float],
        normaliser: Literal["scale", "zscore"],
        task: Task,
        rng: np.random.Generator,
    ) -> None:
        """Args: name: for messages; rng: the stream that random priors draw from."""
        self._name = name
        self._prior = prior
        self._normaliser = normaliser
        self._task = task
        self._rng = rng
        self._seen = RunningMoments()
        self._first: Floats = np.zeros(task.spaces.obs, np.float32)

    def begin_episode(self, obs: Floats) -> None:
        """Remember where the episode began, for priors that refer to it."""
        self._first = _read_only(obs)

    def __call__(self, obs: Obs, act: Floats, info: dict[str, Any], step: int) -> tuple[float, float]:
        """Raw and scaled prior of the step from `obs` by `act` with outcome `info`; raises as `evaluate_prior` does."""
        raw = self._raw(obs, act, info, f'prior "{self._name}" at step {step}')
        self._seen.add(raw)
        return raw, scaled(raw, self._seen, self._normaliser)

    def look(self, obs: Obs, act: Floats, info: dict[str, Any]) -> float:
        """The scaled prior of a step, at the scale as it is: nothing is learned from looking."""
        return scaled(self._raw(obs, act, info, f'prior "{self._name}"'), self._seen, self._normaliser)

    def _raw(self, obs: Obs, act: Floats, info: dict[str, Any], where: str) -> float:
        first = Scene(self._task, self._first)
        step = PriorStep(self._task, _read_only(obs.state), _read_only(act), info, self._rng, first, frames=obs.frames)
        return evaluate_prior(self._prior, step, where)

    def state_dict(self) -> State:
        return {"normaliser": self._seen.state_dict(), "first": self._first}

    def load_state_dict(self, state: State) -> None:
        self._seen.load_state_dict(state["normaliser"])
        self._first = state["first"]


def _read_only(array: Floats) -> Floats:
    """A view that cannot be written: what a prior looks at is what will be stored."""
    view = array.view()
    view.flags.writeable = False
    return view
