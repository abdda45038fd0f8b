"""What the training loop asks of whatever makes its rewards, and when it asks whom."""

# ruff: noqa: B027  (what a source does not override, it takes no part in)

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np

    from rrm.interfaces import Agent
    from rrm.types import Batch, Evaluation, State, Transition


class RewardSource(ABC):
    """A source of rewards. Two methods make one; what else it overrides is what it takes part in."""

    name: ClassVar[str]  #: of its share of a checkpoint; no two sources of a run have the same
    queries: int = 0  #: put to a teacher so far, skipped ones included
    labels: int = 0  #: kept so far

    @abstractmethod
    def reward(self, step: Transition) -> float:
        """The reward that is stored with a step, as it is now."""

    @abstractmethod
    def batch(self, agent: Agent) -> Batch:
        """What the agent learns from next; a source may learn from it first."""

    def ask(self, step: int) -> None:
        """Put the queries that are due before this step; asked again before the same step, nothing more."""

    def waiting(self) -> str | None:
        """What must come from outside before the step can be taken, in words; None where nothing is missing."""

    def attend(self, step: int, agent: Agent) -> None:
        """Learn what is due before the agent learns at this step."""

    def episode_over(self, true_return: float, length: int) -> None:
        """Take notice of a finished training episode."""

    def evaluated(self, step: int, evaluation: Evaluation) -> None:
        """Take notice of an evaluation of the policy as it is."""

    def figures(self, rng: np.random.Generator) -> Mapping[str, float]:
        """What is to stand in a row of the curve; `rng` is of this row alone."""
        del rng
        return {}

    def weights(self) -> State:
        """Tensors that training changes, and that must stay finite."""
        return {}

    def legacy(self) -> State:
        """What a finished run leaves behind beside its agent."""
        return {}

    def publish(self, folder: Path) -> None:
        """Replace what is to be looked at beside the curve."""

    def state_dict(self) -> State:
        """Everything needed to continue exactly."""
        return {}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of a run, up to where the next one begins.

    Its first step is its beginning: the critic is reset and updates are made, if so many are asked for. At every later
    step there is one update, or one every so many steps.
    """

    begin: int  #: its first step
    source: RewardSource
    random: bool = False  #: actions are uniformly random, and nothing is updated
    reset_critic: bool = False
    first_updates: int = 0  #: at the first step
