"""What was asked in a run, what was answered, and when the answer was used: enough to play the feedback back."""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING

import numpy as np
import torch

from rrm.interfaces import Answer, Query, SegmentRef

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.buffers.experience import Experience
    from rrm.buffers.pairs import Preference, Rows
    from rrm.types import State


class Journal:
    """Queries in the order in which they were asked, with their answers."""

    def __init__(self) -> None:
        self._queries: list[Query] = []
        self._answers: list[float | None] = []
        self._applied: list[int] = []  # steps, -1 while not used
        self._settled = 0  # queries before this one are answered and used

    def __len__(self) -> int:
        return len(self._queries)

    @property
    def labels(self) -> int:
        """Answers that were used, skipped queries left out."""
        return sum(answer is not None and not math.isnan(answer) for answer in self._answers[: self._settled])

    @property
    def asked_at(self) -> int | None:
        """The step of the session whose answers are not used yet; None where there is none."""
        return self._queries[self._settled].asked_at if self._settled < len(self) else None

    @property
    def open(self) -> list[Query]:
        """Queries without an answer."""
        return [self._queries[i] for i in range(self._settled, len(self)) if self._answers[i] is None]

    def ask(self, experience: Experience, pairs: Rows, length: int, step: int) -> list[Query]:
        """Write down queries about pairs of segments of `length` steps, int64 [n, 2] first rows, and return them."""
        queries = [
            Query(_digest(experience, pair, length), SegmentRef(first, length), SegmentRef(second, length), step)
            for pair in pairs
            for first, second in [pair.tolist()]
        ]
        self._queries += queries
        self._answers += [None] * len(queries)
        self._applied += [-1] * len(queries)
        return queries

    def answer(self, answer: Answer) -> None:
        """Write down an answer: to the first open query of its id; one to no such query is passed over."""
        for i in range(self._settled, len(self)):
            if self._queries[i].id == answer.query and self._answers[i] is None:
                self._answers[i] = answer.preference
                return

    def apply(self, step: int) -> tuple[Rows, Preference]:
        """Pairs and answers of the session under way, which are used at this step: int64 [n, 2], float32 [n]."""
        queries, answers = self._queries[self._settled :], self._answers[self._settled :]
        self._applied[self._settled :] = [step] * len(queries)
        self._settled = len(self)
        pairs = np.array([(query.first.start, query.second.start) for query in queries], np.int64).reshape(-1, 2)
        return pairs, np.array(answers, np.float32)

    def state_dict(self) -> State:
        """Arrays, one entry a query; the answer -1 stands for none."""
        queries = self._queries
        return {
            "ids": np.array([int(query.id, 16) for query in queries], np.uint64).view(np.int64),
            "rows": np.array([(q.first.start, q.second.start, q.first.length) for q in queries], np.int64),
            "asked": np.array([query.asked_at for query in queries], np.int64),
            "answers": np.array([-1.0 if answer is None else answer for answer in self._answers], np.float32),
            "applied": np.array(self._applied, np.int64),
        }

    def load_state_dict(self, state: State) -> None:
        ids = state["ids"].view(np.uint64).tolist()
        rows = state["rows"].reshape(-1, 3).tolist()
        self._queries = [
            Query(f"{name:016x}", SegmentRef(first, length), SegmentRef(second, length), step)
            for name, (first, second, length), step in zip(ids, rows, state["asked"].tolist(), strict=True)
        ]
        self._answers = [None if answer == -1 else answer for answer in state["answers"].tolist()]
        self._applied = state["applied"].tolist()
        self._settled = sum(step >= 0 for step in self._applied)


def _digest(experience: Experience, pair: Sequence[int] | Rows, length: int) -> str:
    """Sixteen hex digits that stand for what both segments show, wherever they are stored."""
    both = experience.segments(torch.as_tensor(np.asarray(pair)), length)
    digest = hashlib.sha256(both.obs.cpu().numpy().tobytes())
    digest.update(both.act.cpu().numpy().tobytes())
    return digest.hexdigest()[:16]
