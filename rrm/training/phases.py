"""What happens when: the phases of a run, each with where its rewards come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rrm.sources.base import RewardSource


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A stretch of a run, up to where the next one begins.

    Its first step is its beginning: the critic is reset and updates are made, if so many are asked for. At every later
    step there is one update, or one every so many steps.
    """

    name: str
    begin: int  #: its first step
    source: RewardSource
    random: bool = False  #: actions are uniformly random, and nothing is updated
    reset_critic: bool = False
    first_updates: int = 0  #: at the first step

    def updates(self, step: int, every: int) -> int:
        """How many updates are due at a step of this phase, one `every` so many steps."""
        if step == self.begin:
            return self.first_updates
        return int(not self.random and step % every == 0)


def phase_at(phases: Sequence[Phase], step: int) -> Phase:
    """The last phase that has begun; one that another begins with has no step of its own."""
    return next(phase for phase in reversed(phases) if phase.begin <= step)
