"""Running mean and variance, batch by batch (Chan, Golub and LeVeque 1979; Welford's rule for batches of one)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rrm.types import State

if TYPE_CHECKING:
    from torch import Tensor


class RunningMoments:
    """Mean and standard deviation of all numbers added so far, in float64."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._squares = 0.0  # sum of squared deviations from the mean

    def add(self, mean: float, variance: float = 0.0, count: int = 1) -> None:
        """Take in one number, or `count` numbers of this mean and population variance."""
        delta = mean - self.mean
        total = self.count + count
        self.mean += delta * count / total
        self._squares += variance * count + delta * delta * self.count * count / total
        self.count = total

    @property
    def std(self) -> float:
        """Sample standard deviation (divisor n - 1); 1 until there are two numbers."""
        return 1.0 if self.count < 2 else math.sqrt(self._squares / (self.count - 1))

    def over_std(self, values: Tensor) -> Tensor:
        """The values over the deviation, where there is one."""
        return values / (self.std or 1.0)

    def state_dict(self) -> State:
        return {"count": self.count, "mean": self.mean, "squares": self._squares}

    def load_state_dict(self, state: State) -> None:
        self.count, self.mean, self._squares = int(state["count"]), float(state["mean"]), float(state["squares"])
