"""The reward of PEBBLE's unsupervised phase: how far a state is from what has been seen (Lee et al. 2021)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rrm.moments import RunningMoments
from rrm.sources.base import RewardSource

if TYPE_CHECKING:
    from rrm.buffers.experience import Experience
    from rrm.buffers.replay import Replay
    from rrm.interfaces import Agent
    from rrm.types import Batch, State, Transition

_SPARE_NEIGHBOURS = 4  # candidates beyond the k nearest, for those that rounding puts in the wrong order


class StateEntropy(RewardSource):
    """Distance to the k-th nearest neighbour over its running standard deviation; no logarithm, no mean subtracted.

    B-Pref's running moments add a weight where they should multiply by it; these are Chan's.
    """

    name = "entropy"

    def __init__(self, stored: RewardSource, experience: Experience, replay: Replay, neighbours: int) -> None:
        """Args: stored: says what is stored with a step, to be learned from later; neighbours: k."""
        self._stored = stored
        self._experience = experience
        self._replay = replay
        self._neighbours = neighbours
        self._moments = RunningMoments()

    def reward(self, step: Transition) -> float:
        return self._stored.reward(step)

    def batch(self, agent: Agent) -> Batch:  # noqa: ARG002 (the seam of others)
        batch = self._replay.sample()
        return batch._replace(reward=self.scaled(neighbour_distance(self._experience, batch.obs, self._neighbours)))

    def scaled(self, distance: Tensor) -> Tensor:
        """Rewards float32 [B] for distances [B]; the deviation takes the batch in first."""
        values = distance.double()
        self._moments.add(float(values.mean()), float(values.var(correction=0)), len(values))
        deviation = self._moments.std
        return (distance / deviation).to(torch.float32) if deviation > 0 else torch.zeros_like(distance)

    def state_dict(self) -> State:
        return self._moments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._moments.load_state_dict(state)


def neighbour_distance(experience: Experience, obs: Tensor, k: int) -> Tensor:
    """Distance of each of `obs` [B, O] to its k-th nearest neighbour among all stored states, itself left out: [B].

    `obs` come from the experience, so each is its own nearest neighbour. Raw observations, Euclidean (PEBBLE,
    section 4.1).
    """
    stored = experience.near.obs[: experience.rows]
    # A matrix product finds the candidates; it loses the digits of small distances, so theirs are taken again.
    center = obs.mean(dim=0)
    distance = torch.cdist(obs - center, stored - center, compute_mode="use_mm_for_euclid_dist")
    distance[:, [e.start + e.length for e in experience.episodes]] = torch.inf  # not states of a transition
    rank = min(k, experience.transitions - 1)
    candidates = min(rank + 1 + _SPARE_NEIGHBOURS, experience.transitions)
    nearest = distance.topk(candidates, largest=False, sorted=False).indices
    exact = (stored[nearest] - obs.unsqueeze(1)).square().sum(dim=-1).sqrt()
    return exact.sort(dim=-1).values[:, rank]
