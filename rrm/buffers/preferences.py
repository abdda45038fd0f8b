"""The labelled pairs of segments: a ring of row numbers into the experience, which keeps the segments themselves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.buffers.experience import Experience
from rrm.types import Segments, State

FIRST, SECOND, EQUAL, SKIPPED = 0, 1, -1, -2  #: a teacher's answers
Rows = npt.NDArray[np.int64]
Labels = npt.NDArray[np.int8]


class Preferences:
    """The newest `capacity` labelled pairs (the preference buffer D of the paper)."""

    def __init__(self, capacity: int, segment: int) -> None:
        """Args: capacity: labels kept; segment: steps of a segment."""
        self.segment = segment
        self._pairs = np.zeros((capacity, 2), np.int64)
        self._labels = np.zeros(capacity, np.int8)
        self._added = 0

    def __len__(self) -> int:
        return min(self._added, len(self._labels))

    @property
    def pairs(self) -> Rows:
        """First rows of both segments of every labelled pair, int64 [n, 2]."""
        return self._pairs[: len(self)]

    @property
    def labels(self) -> Labels:
        """0 where the first is preferred, 1 the second, -1 neither; int8 [n]."""
        return self._labels[: len(self)]

    def add(self, pairs: Rows, labels: Labels) -> None:
        """Append labelled pairs, int64 [n, 2] and int8 [n]; the oldest give way."""
        slots = (self._added + np.arange(len(labels))) % len(self._labels)
        self._pairs[slots] = pairs
        self._labels[slots] = labels
        self._added += len(labels)

    def state_dict(self) -> State:
        return {"pairs": self.pairs.copy(), "labels": self.labels.copy(), "added": self._added}

    def load_state_dict(self, state: State) -> None:
        count = len(state["labels"])
        self._pairs[:count] = state["pairs"]
        self._labels[:count] = state["labels"]
        self._added = int(state["added"])


class LabelledSegments:
    """What a feedback session hands the learner: the labelled pairs, with their segments looked up on demand."""

    def __init__(self, experience: Experience, preferences: Preferences) -> None:
        self._experience = experience
        self._preferences = preferences
        self._pairs = torch.from_numpy(preferences.pairs)
        self._labels = torch.from_numpy(preferences.labels)

    def __len__(self) -> int:
        return len(self._labels)

    def pairs(self, index: Tensor) -> tuple[Segments, Segments, Tensor]:
        """Both segments of the pairs at `index` [...] and the probability that the second is preferred, of that shape.

        The probability is 0 or 1, or one half where the teacher called them equal.
        """
        rows = self._pairs[index]
        labels = self._labels[index]
        target = torch.where(labels == EQUAL, 0.5, labels.float())
        length = self._preferences.segment
        return self._experience.segments(rows[..., 0], length), self._experience.segments(rows[..., 1], length), target
