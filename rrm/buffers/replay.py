"""Which stored transitions an update sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from rrm.types import Batch

if TYPE_CHECKING:
    from torch import Tensor

    from rrm.buffers.experience import Experience


class Replay:
    """Uniform draws from the experience, with replacement."""

    def __init__(self, experience: Experience, batch: int, generator: torch.Generator, repeat: int = 1) -> None:
        """Args:
        batch: transitions of an agent's update.
        generator: the stream that draws them.
        repeat: environment steps of a transition.
        """
        self._experience = experience
        self._size = batch
        self._generator = generator
        self._repeat = repeat

    @property
    def steps(self) -> int:
        """Environment steps that are stored."""
        return self.transitions * self._repeat

    @property
    def transitions(self) -> int:
        """So many are stored."""
        return self._experience.transitions

    def sample(self, *, time_limits_end: bool = False) -> Batch:
        """What an update of the agent sees: transitions, or windows of them for an agent that sees frames.

        `time_limits_end` as in `Experience.batch`, of transitions alone.
        """
        if self._experience.frames is None:
            return self.draw(self._size, self._generator, time_limits_end=time_limits_end)
        numbers = torch.randint(self._experience.windows, (self._size,), generator=self._generator)
        return self._experience.batch_of_windows(numbers)

    def draw(
        self, count: int, generator: torch.Generator, *, newest: int | None = None, time_limits_end: bool = False
    ) -> Batch:
        """`count` transitions, where `newest` is given of the last so many alone."""
        first = 0 if newest is None else max(0, self.transitions - newest)
        numbers = torch.randint(first, self.transitions, (count,), generator=generator)
        return self._experience.batch(numbers, time_limits_end=time_limits_end)

    def batch(self, numbers: Tensor) -> Batch:
        """Transitions by number, int64 [B], counted from 0 in the order in which they were lived."""
        return self._experience.batch(numbers)
