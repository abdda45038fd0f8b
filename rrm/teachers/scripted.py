"""The scripted teacher of B-Pref: prefers the segment with the larger true reward, with named human failings.

In order: it skips pairs in which neither segment is worth anything; it weighs recent steps more (`gamma`); it answers
by the Bradley-Terry model at rationality `beta`, or without doubt; it errs with probability `mistake`; it calls close
pairs equal. Thresholds are shares of what a segment of the agent's last ten episodes is worth. B-Pref's code
multiplies them by their share twice from the second session on and starts its window with an episode of return 0;
neither is repeated here.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rrm.buffers.preferences import EQUAL, FIRST, SECOND, SKIPPED, Labels
from rrm.interfaces import Floats
from rrm.types import State

if TYPE_CHECKING:
    from rrm.config import TeacherConfig

_WINDOW = 10  # episodes


class ScriptedTeacher:
    """Labels pairs of segments from their true rewards."""

    def __init__(self, config: TeacherConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._rng = rng
        self._per_step: deque[float] = deque(maxlen=_WINDOW)  # mean true reward of the newest episodes

    def observe_return(self, true_return: float, length: int) -> None:
        self._per_step.append(true_return / length)

    def label(self, true_rewards: tuple[Floats, Floats]) -> Labels:
        first, second = (r.astype(np.float64) for r in true_rewards)
        config = self.config
        sums = np.stack([first.sum(1), second.sum(1)])
        typical = float(np.mean(self._per_step)) * first.shape[1] if self._per_step else 0.0

        labels = self._prefer(recency_weighted(first, config.gamma), recency_weighted(second, config.gamma))
        flipped = self._rng.random(len(labels)) < config.mistake
        labels = np.where(flipped, FIRST + SECOND - labels, labels).astype(np.int8)
        labels[np.abs(sums[0] - sums[1]) < config.equal * typical] = EQUAL
        if config.skip * typical > 0:  # where a typical segment is worth less than nothing there is no such threshold
            labels[sums.max(axis=0) <= config.skip * typical] = SKIPPED
        return labels

    def _prefer(self, first: npt.NDArray[np.float64], second: npt.NDArray[np.float64]) -> Labels:
        if self.config.beta is None:
            return (first < second).astype(np.int8)
        probability = preference_probability(second - first, self.config.beta)
        return (self._rng.random(len(first)) < probability).astype(np.int8)

    def state_dict(self) -> State:
        return {"per_step": list(self._per_step)}

    def load_state_dict(self, state: State) -> None:
        self._per_step = deque(state["per_step"], maxlen=_WINDOW)


def recency_weighted(rewards: npt.NDArray[np.float64], gamma: float) -> npt.NDArray[np.float64]:
    """Sum of [B, T] rewards with weight gamma ** (T - 1 - t): [B]. Plain sums at gamma 1."""
    weights = gamma ** np.arange(rewards.shape[1] - 1, -1, -1)
    weighted: npt.NDArray[np.float64] = rewards @ weights
    return weighted


def preference_probability(difference: npt.NDArray[np.float64], beta: float) -> npt.NDArray[np.float64]:
    """Bradley-Terry probability that the segment worth `difference` more is preferred, without overflow."""
    probability: npt.NDArray[np.float64] = np.exp(-np.logaddexp(0.0, -beta * difference))
    return probability
