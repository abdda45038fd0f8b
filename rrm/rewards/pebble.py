"""PEBBLE's way to train a reward from preferences: an ensemble fitted to all labels so far (Lee et al. 2021; B-Pref).

Whether the reward is a network alone or a prior with a residual makes no difference here. Departures from B-Pref:
pairs called equal are left out of the accuracy, and the loss always accepts them.
"""

from __future__ import annotations

import copy
import math

import numpy as np
import torch
from torch import Tensor

from rrm.config import RewardConfig
from rrm.errors import NumericalError
from rrm.interfaces import CriticAgent, Feedback, Needs, RewardFunction
from rrm.losses import preference_logit, preference_loss
from rrm.types import Batch, Segments, State

#: Pairs of each member, forward and backward, by the kind of device: their activations fit into a processor's caches; a
#: card takes a minibatch as a whole.
PAIRS_AT_ONCE = {"cpu": 16, "cuda": 1 << 12}


def told_right(logit: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Pairs whose label the members' log-odds [N, B] agree with, and pairs without a tie, over all members."""
    clear = target != 0.5
    right = ((logit > 0) == (target > 0.5)) & clear
    return right.sum(), clear.sum()


def learned(accuracy: float, loss: float, labels: int) -> dict[str, float]:
    """What every fit returns, unless the loss is not finite."""
    if not np.isfinite(loss):
        raise NumericalError(f"the loss of the reward is {loss} after {labels} labels")
    return {"label_accuracy": accuracy, "reward_loss": loss}


class Pebble:
    """Cross-entropy of the Bradley-Terry model, every member with its own order of the labels."""

    needs = Needs()

    def __init__(self, reward: RewardFunction, config: RewardConfig, rng: np.random.Generator) -> None:
        """Args: rng: the stream that shuffles labels."""
        self.reward = reward
        self.config = config
        self._rng = rng
        self._optimizer = torch.optim.Adam(reward.parameters(), lr=config.lr, fused=True)
        self._device = reward.parameters()[0].device
        self._at_once = PAIRS_AT_ONCE[self._device.type]

    def fit(self, feedback: Feedback) -> dict[str, float]:
        """Up to `epochs` passes over all labels and `most_steps` gradient steps, until the accuracy of an epoch exceeds
        `target_accuracy`.

        Returns `label_accuracy` of the last epoch (each minibatch before its step, ties left out; NaN if all are ties),
        `reward_loss`, and `epochs` done.
        """
        epochs = 0
        accuracy = loss = float("nan")
        left = self.config.most_steps or math.inf
        while left and epochs < self.config.epochs and not accuracy > self.config.target_accuracy:
            accuracy, loss, steps = self._epoch(feedback, left)
            epochs, left = epochs + 1, left - steps
        return {**learned(accuracy, loss, len(feedback)), "epochs": float(epochs)}

    def _epoch(self, feedback: Feedback, most: float) -> tuple[float, float, int]:
        """Accuracy and loss of a pass of so many gradient steps at the most, and how many there were."""
        members, count, steps = self.config.members, len(feedback), 0
        order = torch.from_numpy(np.stack([self._rng.permutation(count) for _ in range(members)]))
        figures = torch.zeros(3, device=self._device)
        for index in torch.split(order, self.config.minibatch, dim=1):
            self._optimizer.zero_grad(set_to_none=True)
            # The gradient of a minibatch is the sum over its parts, which fit into the caches.
            for part in torch.split(index, self._at_once, dim=1):
                first, second, target = feedback.pairs(part)
                rewards, penalty = self._rewards(first, second)
                logit = preference_logit(*rewards)
                loss = preference_loss(logit, target) + penalty
                (loss * (part.shape[1] / index.shape[1])).backward()  # type: ignore[no-untyped-call]
                figures += torch.stack((*told_right(logit.detach(), target), loss.detach() * part.shape[1]))
            self._step()
            steps += 1
            if steps == most:
                count = min(count, steps * self.config.minibatch)
                break
        right, decided, total = figures.tolist()
        return right / decided if decided else float("nan"), total / count, steps

    def _step(self) -> None:
        """Step along the gradient of the whole minibatch."""
        self._optimizer.step()

    def _rewards(self, first: Segments, second: Segments) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """What every member says of each step of both segments, [N, B, T] each, and the penalty on it."""
        both = Segments(*(torch.cat([a, b], dim=1) for a, b in zip(first, second, strict=True)))
        rewards = self.reward.members(both)
        r_first, r_second = rewards.chunk(2, dim=1)
        return (r_first, r_second), self.reward.penalty(rewards, both)

    def refine(self, batch: Batch, agent: CriticAgent, feedback: Feedback) -> bool:  # noqa: ARG002 (the seam of others)
        return False  # PEBBLE learns in sessions alone

    def metrics(self) -> dict[str, float]:
        return {}

    def state_dict(self) -> State:
        return {"reward": self.reward.state_dict(), "optimizer": adam_state(self._optimizer)}

    def load_state_dict(self, state: State) -> None:
        self.reward.load_state_dict(state["reward"])
        load_adam_state(self._optimizer, state["optimizer"])


def adam_state(optimizer: torch.optim.Optimizer) -> State:
    """The optimiser's moments, as a checkpoint holds them."""
    return copy.deepcopy(optimizer.state_dict()["state"])


def load_adam_state(optimizer: torch.optim.Optimizer, state: State) -> None:
    """Continue where `adam_state` was taken."""
    moments = {int(key): value for key, value in state.items()}
    optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
