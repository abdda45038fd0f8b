"""Rewards that nothing has to learn: the true one (the oracle's), and a prior alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rrm.sources.base import RewardSource

if TYPE_CHECKING:
    from rrm.buffers.replay import Replay
    from rrm.interfaces import Agent
    from rrm.types import Batch, Transition


class TrueReward(RewardSource):
    """The environment's own reward."""

    name = "known"

    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def reward(self, step: Transition) -> float:
        return step.true_reward

    def batch(self, agent: Agent) -> Batch:  # noqa: ARG002 (the seam of others)
        return self._replay.sample()


class PriorAlone(TrueReward):
    """The scaled prior, as it is stored."""

    def reward(self, step: Transition) -> float:
        return step.prior
