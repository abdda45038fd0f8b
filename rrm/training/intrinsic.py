"""The reward of PEBBLE's unsupervised phase: how far a state is from what has been seen (Lee et al. 2021)."""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.moments import RunningMoments
from rrm.types import State


class StateEntropy:
    """Distance to the k-th nearest neighbour over its running standard deviation; no logarithm, no mean subtracted.

    B-Pref's running moments add a weight where they should multiply by it; these are Chan's.
    """

    def __init__(self, neighbours: int) -> None:
        """Args: neighbours: k."""
        self.neighbours = neighbours
        self._moments = RunningMoments()

    def __call__(self, distance: Tensor) -> Tensor:
        """Rewards float32 [B] for distances [B]; the deviation takes the batch in first."""
        values = distance.double()
        self._moments.add(float(values.mean()), float(values.var(correction=0)), len(values))
        deviation = self._moments.std
        return (distance / deviation).to(torch.float32) if deviation > 0 else torch.zeros_like(distance)

    def state_dict(self) -> State:
        return self._moments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._moments.load_state_dict(state)
