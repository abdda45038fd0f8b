"""The prior value of each transition, computed once, while the transition is collected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rrm.envs import Task
from rrm.priors.scale import Normaliser
from rrm.priors.step import PriorStep, Scene, evaluate_prior
from rrm.types import Floats, State


class PriorSource:
    """A prior with its running scale, fed one transition at a time."""

    def __init__(
        self,
        name: str,
        prior: Callable[[PriorStep], float],
        normaliser: Normaliser,
        task: Task,
        rng: np.random.Generator,
    ) -> None:
        """Args: name: for messages; rng: the stream that random priors draw from."""
        self._name = name
        self._prior = prior
        self._normaliser = normaliser
        self._task = task
        self._rng = rng
        self._first: Floats = np.zeros(task.spaces.obs, np.float32)

    def begin_episode(self, obs: Floats) -> None:
        """Remember where the episode began, for priors that refer to it."""
        self._first = _read_only(obs)

    def __call__(self, obs: Floats, act: Floats, info: dict[str, Any], step: int) -> tuple[float, float]:
        """Raw and scaled prior of the step from `obs` by `act` whose outcome is `info`.

        Raises:
            PriorError: the prior raised, or returned something else than one finite number.
        """
        raw = self._raw(obs, act, info, f'prior "{self._name}" at step {step}')
        return raw, self._normaliser(raw)

    def look(self, obs: Floats, act: Floats, info: dict[str, Any]) -> float:
        """The scaled prior of a step, at the scale as it is: nothing is learned from looking. Raises as a call does."""
        return self._normaliser.scaled(self._raw(obs, act, info, f'prior "{self._name}"'))

    def _raw(self, obs: Floats, act: Floats, info: dict[str, Any], where: str) -> float:
        first = Scene(self._task, self._first)
        step = PriorStep(
            task=self._task, obs=_read_only(obs), act=_read_only(act), info=info, rng=self._rng, first=first
        )
        return evaluate_prior(self._prior, step, where)

    def state_dict(self) -> State:
        return {"normaliser": self._normaliser.state_dict(), "first": self._first}

    def load_state_dict(self, state: State) -> None:
        self._normaliser.load_state_dict(state["normaliser"])
        self._first = state["first"]


def _read_only(array: Floats) -> Floats:
    """A view that cannot be written: what a prior looks at is what will be stored."""
    view = array.view()
    view.flags.writeable = False
    return view
