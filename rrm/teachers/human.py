"""People as teachers: their answers come in a file, long after the queries were put.

Answers count by the session: before all of them are there and sealed there is none.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from typing import TYPE_CHECKING

from rrm.errors import LabelError
from rrm.interfaces import Answer, Query
from rrm.teachers.labels import live, preference, read_labels
from rrm.teachers.published import PlayedEpisode, PublishedQuery, PublishedSession, ShownSegment, publish, segment_id

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rrm.buffers.experience import Experience
    from rrm.envs.tasks import Ranges
    from rrm.interfaces import SegmentRef
    from rrm.teachers.labels import Label
    from rrm.types import State


class ReplayTeacher:
    """Says what people said to the queries of a run. It never waits: a `LabelError` says what is missing."""

    def __init__(self, path: Path, run: str) -> None:
        """Args: path: a file of answers, those to `run` (an identity) among them."""
        self._path = path
        self._run = run
        self._open: list[Query] = []
        self._before = 0  # queries of earlier sessions

    def ask(self, queries: Sequence[Query]) -> None:
        self._open = list(queries)

    def answers(self) -> list[Answer]:
        if not self._open:
            return []
        given = self._given()
        if given is None:
            return self._without()
        self._before += len(self._open)
        self._open = []
        return given

    def _given(self) -> list[Answer] | None:
        """What was said to the session under way; None where not all of it is sealed. Answers to others are refused."""
        step = self._open[0].asked_at
        labels = {index: label for (at, index), label in live(self._read()).items() if at == step}
        asked = dict(enumerate(self._open, self._before))
        for index, label in labels.items():
            if index not in asked or label.query != asked[index].id:
                raise self._foreign(f"query {index} before step {step} is not {label.query}")
        if not all(index in labels and labels[index].sealed for index in asked):
            return None
        return [Answer(query.id, preference(labels[index])) for index, query in asked.items()]

    def _read(self) -> list[Label]:
        """Answers to this run's queries."""
        return [label for label in read_labels(self._path) if label.run == self._run]

    def _foreign(self, why: str) -> LabelError:
        return LabelError(
            f"{self._path} holds labels of another run than {self._run}, or of a machine that rounds differently: "
            f"{why}; move it away and bring this run's own"
        )

    def _without(self) -> list[Answer]:
        raise LabelError(
            f"{self._path} does not hold all answers of run {self._run} to its queries before step "
            f"{self._open[0].asked_at}: export them from the results of that run, once it is done"
        )

    def observe_return(self, true_return: float, length: int) -> None:
        """Nothing: people are told no thresholds."""

    def state_dict(self) -> State:
        return {"before": self._before}

    def load_state_dict(self, state: State) -> None:
        self._before = int(state["before"])


class HumanTeacher(ReplayTeacher):
    """Puts queries before people, as clips that can be played again, and takes their answers from the same folder."""

    def __init__(
        self, path: Path, run: str, experience: Experience, *, task: str, ranges: Ranges, repeat: int,
        horizon: int, window: int,
    ) -> None:  # fmt: skip
        """Args:
        path: of the run's answers. Queries are published beside it.
        run: its identity.
        experience: what the rows of queries are of.
        task, ranges, repeat, horizon: as in `PublishedSession`.
        window: newest complete episodes that queries are about.
        """
        super().__init__(path, run)
        self._experience = experience
        self._task, self._ranges, self._repeat, self._horizon = task, ranges, repeat, horizon
        self._starts: deque[tuple[int, State]] = deque(maxlen=window + 1)  # of episodes: first row, and environment

    def begins(self, env: State) -> None:
        """Take notice of an episode that begins, with the environment in this state."""
        self._starts.append((self._experience.rows, env))

    def _read(self) -> list[Label]:
        labels = read_labels(self._path)
        for label in labels:
            if label.run != self._run:
                raise self._foreign(f"{label.query} was asked by {label.run or 'none'}")
        return labels

    def _without(self) -> list[Answer]:
        return []

    def publish(self) -> None:
        """Write down the session that waits for answers, where one does."""
        if not self._open:
            return
        first_rows = [row for row, _ in self._starts]

        def begin(segment: SegmentRef) -> int:
            return first_rows[bisect_right(first_rows, segment.start) - 1]

        ends: dict[int, int] = {}  # of what is shown of each episode, by its first row
        for segment in (segment for query in self._open for segment in (query.first, query.second)):
            ends[begin(segment)] = max(ends.get(begin(segment), 0), segment.start + segment.length)
        obs, act = self._experience.obs.numpy(), self._experience.act.numpy()
        rows, starts = sorted(ends), dict(self._starts)
        episodes = [PlayedEpisode(starts[row], obs[row : ends[row] + 1], act[row : ends[row]]) for row in rows]

        def shown(segment: SegmentRef) -> ShownSegment:
            part, row = slice(segment.start, segment.start + segment.length), begin(segment)
            name = segment_id(self._task, obs[part], act[part])
            true_return = self._experience.true_reward[part].double().sum()
            return ShownSegment(name, rows.index(row), segment.start - row, float(true_return))

        queries = tuple(
            PublishedQuery(index, query.id, shown(query.first), shown(query.second))
            for index, query in enumerate(self._open, self._before)
        )
        session = PublishedSession(
            run=self._run, task=self._task, step=self._open[0].asked_at, length=self._open[0].first.length,
            repeat=self._repeat, horizon=self._horizon, queries=queries, ranges=self._ranges,
        )  # fmt: skip
        publish(self._path.parent, session, episodes)

    def state_dict(self) -> State:
        return super().state_dict() | {"starts": [list(start) for start in self._starts]}

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        self._starts.clear()
        self._starts.extend((int(row), env) for row, env in state["starts"])
