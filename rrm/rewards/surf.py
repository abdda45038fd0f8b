"""SURF: PEBBLE with crops of segments, and with labels the members give themselves (Park et al. 2022).

Segments come `margin` steps longer on either side than what the teacher saw. Every gradient step crops each pair: one
random length for both segments, a random start for each. Pairs nobody was asked about count with the label that the
same member gives to their middles, where it is sure enough. Departures from the authors' code: crops are differences of
cumulative sums, ties are left out of the accuracy, and the accuracy is that of the middles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.config import RewardConfig
from rrm.interfaces import Feedback, RewardFunction
from rrm.losses import preference_loss, pseudo_label_loss, window_sums
from rrm.rewards.pebble import Pebble, learned, told_right
from rrm.transfers import to
from rrm.types import Segments, State


class Surf(Pebble):
    """Cross-entropy on crops, of labels and of the members' own pseudo-labels; `reward.surf` holds its settings."""

    def __init__(self, reward: RewardFunction, config: RewardConfig, rng: np.random.Generator) -> None:
        super().__init__(reward, config, rng)
        self.needs = config.surf.needs()
        self._sure = float("nan")  # share of pseudo-labels that counted in the last pass

    def fit(self, feedback: Feedback) -> dict[str, float]:
        """`ceil(epochs * labels / minibatch)` gradient steps, or `most_steps`, however well the labels are told before.

        `label_accuracy` and `reward_loss` are those of the last pass over the labels.
        """
        config, count = self.config, len(feedback)
        labelled = _minibatches(self._rng, config.members, count, config.minibatch)
        unlabelled = _minibatches(self._rng, config.members, feedback.unlabelled, config.minibatch * config.surf.ratio)
        steps, a_pass = (math.ceil(epochs * count / config.minibatch) for epochs in (config.epochs, 1))
        figures, pseudo = torch.zeros(4, device=self._device), 0
        steps = min(steps, config.most_steps or steps)
        a_pass = min(steps, a_pass)
        for step in range(steps):
            if step == steps - a_pass:
                figures, pseudo = torch.zeros(4, device=self._device), 0
            self._optimizer.zero_grad(set_to_none=True)
            figures[:3] += self._labelled(feedback, next(labelled))
            index = next(unlabelled)
            figures[2:] += self._unlabelled(feedback, index)
            pseudo += index.numel()
            self._optimizer.step()
        right, decided, loss, sure = figures.tolist()
        self._sure = sure / pseudo
        return learned(right / decided if decided else float("nan"), loss / a_pass, count)

    def _labelled(self, feedback: Feedback, index: Tensor) -> Tensor:
        """Add the gradient of the labelled pairs at `index` [N, B]: pairs told right, pairs without a tie, loss."""
        figures = torch.zeros(3, device=self._device)
        for part in torch.split(index, self._at_once, dim=1):
            first, second, target = feedback.pairs(part)
            crop, middle, penalty = self._logits(first, second)
            loss = (preference_loss(crop, target) + penalty) * (part.shape[1] / index.shape[1])
            loss.backward()  # type: ignore[no-untyped-call]
            figures += torch.stack((*told_right(middle, target), loss.detach()))
        return figures

    def _unlabelled(self, feedback: Feedback, index: Tensor) -> Tensor:
        """Add the gradient of the pairs without a label at `index` [N, B]: loss, and pseudo-labels that count."""
        figures = torch.zeros(2, device=self._device)
        for part in torch.split(index, self._at_once, dim=1):
            crop, middle, _ = self._logits(*feedback.unlabelled_pairs(part))
            loss, sure = pseudo_label_loss(crop, middle, self.config.surf.threshold)
            loss = loss * (self.config.surf.weight * part.shape[1] / index.shape[1])
            loss.backward()  # type: ignore[no-untyped-call]
            figures += torch.stack((loss.detach(), sure))
        return figures

    def _logits(self, first: Segments, second: Segments) -> tuple[Tensor, Tensor, Tensor]:
        """Log-odds for the second of every pair, [N, B]: cropped, and of the middles; and the penalty."""
        rewards, penalty = self._rewards(first, second)
        steps = torch.cat(rewards, dim=1)
        starts, ends = (to(self._device, torch.from_numpy(edge)) for edge in self._windows(*steps.shape))
        sums = window_sums(steps, starts, ends)
        by_first, by_second = sums.chunk(2, dim=1)
        crop, middle = (by_second - by_first).unbind(dim=-1)
        return crop, middle, penalty

    def _windows(self, members: int, segments: int, steps: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Where windows begin and end, [N, 2 B, 2] each: a random crop of each segment, and its middle."""
        surf = self.config.surf
        middle = steps - 2 * surf.margin
        shape = members, segments // 2
        length = self._rng.integers(middle - surf.crop, middle + surf.crop, size=shape, endpoint=True)
        length = np.concatenate((length, length), axis=1)
        start = self._rng.integers(0, steps - length, endpoint=True)
        starts = np.stack((start, np.full_like(start, surf.margin)), axis=-1)
        ends = np.stack((start + length, np.full_like(start, steps - surf.margin)), axis=-1)
        return starts, ends

    def metrics(self) -> dict[str, float]:
        """`pseudo_labelled`: the share of unlabelled pairs that counted in the last pass; NaN before the first."""
        return {"pseudo_labelled": self._sure}

    def state_dict(self) -> State:
        return super().state_dict() | {"sure": self._sure}

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        self._sure = float(state["sure"])


def _minibatches(rng: np.random.Generator, members: int, count: int, size: int) -> Iterator[Tensor]:
    """Positions, int64 [N, <= size], every member's in an order of its own; shuffled anew when all are drawn."""

    def shuffled() -> Tensor:
        return torch.from_numpy(np.stack([rng.permutation(count) for _ in range(members)]))

    def rounds(order: Tensor) -> Iterator[Tensor]:
        while True:
            yield from torch.split(order, size, dim=1)
            order = shuffled()

    return rounds(shuffled())  # the first order is drawn now
