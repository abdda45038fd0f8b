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

from rrm.buffers.pairs import EQUAL, SKIPPED, Preference
from rrm.interfaces import Answer, Query
from rrm.types import Floats

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rrm.config import TeacherConfig
    from rrm.types import State

_WINDOW = 10  # episodes


class ScriptedTeacher:
    """Answers at once, from the true rewards of both segments."""

    def __init__(
        self,
        config: TeacherConfig,
        rng: np.random.Generator,
        true_rewards: Callable[[npt.NDArray[np.int64], int], Floats],
    ) -> None:
        """Args: true_rewards: of so many steps from each of some rows on; see `Experience.true_rewards`."""
        self.config = config
        self._rng = rng
        self._true_rewards = true_rewards
        self._per_step: deque[float] = deque(maxlen=_WINDOW)  # mean true reward of the newest episodes
        self._given: list[Answer] = []

    def ask(self, queries: Sequence[Query]) -> None:
        if not queries:
            return
        starts = np.array([(query.first.start, query.second.start) for query in queries], np.int64)
        rewards = self._true_rewards(starts, queries[0].first.length)
        preferences = self.prefer(rewards[:, 0], rewards[:, 1]).tolist()
        self._given += [Answer(query.id, value) for query, value in zip(queries, preferences, strict=True)]

    def answers(self) -> list[Answer]:
        given, self._given = self._given, []
        return given

    def observe_return(self, true_return: float, length: int) -> None:
        self._per_step.append(true_return / length)

    def prefer(self, first_rewards: Floats, second_rewards: Floats) -> Preference:
        """For each pair of segments, whose true rewards are given, [B, T] each: 0, 1, 1/2 or NaN, float32 [B]."""
        first, second = first_rewards.astype(np.float64), second_rewards.astype(np.float64)
        config = self.config
        sums = np.stack([first.sum(1), second.sum(1)])
        typical = float(np.mean(self._per_step)) * first.shape[1] if self._per_step else 0.0

        worth = [recency_weighted(rewards, config.gamma) for rewards in (first, second)]
        if config.beta is None:
            prefers = worth[0] < worth[1]
        else:
            prefers = self._rng.random(len(first)) < preference_probability(worth[1] - worth[0], config.beta)
        flipped = self._rng.random(len(prefers)) < config.mistake
        preference: Preference = (prefers != flipped).astype(np.float32)
        preference[np.abs(sums[0] - sums[1]) < config.equal * typical] = EQUAL
        if config.skip * typical > 0:  # where a typical segment is worth less than nothing there is no such threshold
            preference[sums.max(axis=0) <= config.skip * typical] = SKIPPED
        return preference

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
