"""Rewards that nothing has to learn: the true one (the oracle's), and a prior alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from rrm.sources.base import RewardSource

if TYPE_CHECKING:
    from rrm.buffers.replay import Replay
    from rrm.interfaces import Agent
    from rrm.types import Batch, Transition


class Known(RewardSource):
    """The environment's own reward times a factor, or the scaled prior as it is stored."""

    name = "known"

    def __init__(self, replay: Replay, field: Literal["true_reward", "prior"], factor: float = 1.0) -> None:
        """Args: field: of a step, which times `factor` is its reward."""
        self._replay = replay
        self._field = field
        self._factor = factor

    def reward(self, step: Transition) -> float:
        return self._factor * float(getattr(step, self._field))

    def batch(self, agent: Agent) -> Batch:  # noqa: ARG002 (the seam of others)
        return self._replay.sample()
