"""Pairs of segments, labelled or not: rings of row numbers into the experience, which keeps the segments themselves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.buffers.experience import Experience
from rrm.transfers import to
from rrm.types import Segments, State

FIRST, SECOND, EQUAL, SKIPPED = 0.0, 1.0, 0.5, float("nan")  #: a teacher's answers
Rows = npt.NDArray[np.int64]
Preference = npt.NDArray[np.float32]


class PairRing:
    """The newest `capacity` pairs of segments."""

    def __init__(self, capacity: int, segment: int) -> None:
        """Args: capacity: pairs kept; segment: steps of a segment."""
        self.segment = segment
        self._pairs = np.zeros((capacity, 2), np.int64)
        self._added = 0

    def __len__(self) -> int:
        return min(self._added, len(self._pairs))

    @property
    def pairs(self) -> Rows:
        """First rows of both segments of every pair, int64 [n, 2]."""
        return self._pairs[: len(self)]

    def newest(self, count: int) -> Rows:
        """Where in `pairs` the newest `count` are, or all where there are fewer, newest last: int64 [<= count]."""
        positions: Rows = (self._added - np.arange(min(count, len(self)), 0, -1)) % len(self._pairs)
        return positions

    def put(self, pairs: Rows) -> Rows:
        """Append pairs, int64 [n, 2]; the oldest give way. Returns where they are now, int64 [n]."""
        slots: Rows = (self._added + np.arange(len(pairs))) % len(self._pairs)
        self._pairs[slots] = pairs
        self._added += len(pairs)
        return slots

    def state_dict(self) -> State:
        return {"pairs": self.pairs.copy(), "added": self._added}

    def load_state_dict(self, state: State) -> None:
        self._pairs[: len(state["pairs"])] = state["pairs"]
        self._added = int(state["added"])


class Preferences(PairRing):
    """The newest `capacity` labelled pairs (the preference buffer D of the paper)."""

    def __init__(self, capacity: int, segment: int) -> None:
        super().__init__(capacity, segment)
        self._labels = np.zeros(capacity, np.float32)

    @property
    def labels(self) -> Preference:
        """Probability that the second is preferred: 0, 1, or 1/2 where neither is; float32 [n]."""
        return self._labels[: len(self)]

    def add(self, pairs: Rows, labels: Preference) -> None:
        """Append labelled pairs, int64 [n, 2] and float32 [n]; the oldest give way."""
        self._labels[self.put(pairs)] = labels

    def state_dict(self) -> State:
        return super().state_dict() | {"labels": self.labels.copy()}

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        self._labels[: len(self)] = state["labels"]


class StoredFeedback:
    """An `rrm.interfaces.Feedback` over what is stored now, with the segments looked up on demand."""

    def __init__(self, experience: Experience, preferences: Preferences, unlabelled: PairRing, batch: int) -> None:
        """Args: batch: queries of a session."""
        self._experience = experience
        self._preferences = preferences
        self._unlabelled = unlabelled
        self._batch = batch

    def __len__(self) -> int:
        return len(self._preferences)

    @property
    def unlabelled(self) -> int:
        return len(self._unlabelled)

    def pairs(self, index: Tensor) -> tuple[Segments, Segments, Tensor]:
        target = to(self._experience.device, torch.from_numpy(self._preferences.labels)[index])
        return *self._segments(self._preferences, index), target

    def newest(self) -> Tensor:
        return torch.from_numpy(self._preferences.newest(self._batch))

    def unlabelled_pairs(self, index: Tensor) -> tuple[Segments, Segments]:
        return self._segments(self._unlabelled, index)

    def _segments(self, ring: PairRing, index: Tensor) -> tuple[Segments, Segments]:
        rows = torch.from_numpy(ring.pairs)[index]
        first, second = (self._experience.segments(rows[..., i], ring.segment) for i in (0, 1))
        return first, second
