"""The reward that is learned from preferences (algorithm 1, lines 4 to 14).

A feedback session chooses queries and puts them to the teacher; when all are answered it fits the reward and gives
every stored transition its new one. A teacher that answers at once is never noticed; of another the run waits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import torch

from rrm.buffers.pairs import PairRing, Preferences, StoredFeedback
from rrm.queries import select, uniform_pairs
from rrm.sources.base import RewardSource
from rrm.teachers.journal import Journal
from rrm.transfers import to

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rrm.buffers.experience import Experience
    from rrm.buffers.replay import Replay
    from rrm.config import FeedbackConfig
    from rrm.interfaces import Agent, CriticAgent, RewardFunction, RewardLearner, Teacher, VisualAgent
    from rrm.rewards.sight import Sight
    from rrm.types import Batch, State, Transition

_ACCURACY_PAIRS = 256
_UNLABELLED_PAIRS = 500_000  # newest ones kept (SURF)


class PreferenceReward(RewardSource):
    """The feedback of one run: when it is due, what was asked and answered, and the reward that is learned from it."""

    name = "preferences"

    def __init__(
        self,
        config: FeedbackConfig,
        *,
        first: int,
        steps: int,
        capacity: int,
        experience: Experience,
        replay: Replay,
        learner: RewardLearner,
        teacher: Teacher,
        rng: np.random.Generator,
        unlabelled_rng: np.random.Generator,
        sight: Sight | None = None,
        twin: RewardFunction | None = None,
    ) -> None:
        """Args:
        first: step before which the first session is held.
        steps: of the run.
        capacity: labelled pairs kept.
        rng, unlabelled_rng: the streams that draw candidate segments, and pairs nobody is asked about.
        sight: what the reward sees of frames; None where it is shown observations.
        twin: a reward like the learner's on the processor, which says what a step is worth where that of a card would
            have to be waited for.
        """
        self._config = config
        self._first = first
        self._steps = steps
        self._experience = experience
        self._replay = replay
        self.learner = learner
        self.teacher = teacher
        self._rng = rng
        self._unlabelled_rng = unlabelled_rng
        self._sight = sight
        self._twin = twin
        self._imitate()
        self._length = config.segment + 2 * learner.needs.margin  # steps of a segment as the learner sees it
        self.preferences = Preferences(capacity, self._length)
        self.unlabelled = PairRing(_UNLABELLED_PAIRS, self._length)
        self.feedback = StoredFeedback(experience, self.preferences, self.unlabelled, config.batch)
        self.journal = Journal()
        self._label_accuracy = float("nan")  # of the last fit

    @property
    def queries(self) -> int:  # type: ignore[override]
        return len(self.journal)

    @property
    def labels(self) -> int:  # type: ignore[override]
        return self.journal.labels

    def reward(self, step: Transition) -> float:
        seen = torch.from_numpy(step.obs)[None]
        if self._sight is not None and step.frames is not None:
            seen = self._sight.one(step.frames)
        reward = self._twin or self.learner.reward
        device = "cpu" if self._twin is not None else self._experience.device
        shown = seen, torch.from_numpy(step.act)[None], torch.tensor([step.prior])
        return float(reward.predict(*(to(device, part) for part in shown)))

    def _imitate(self) -> None:
        """Have the twin say what the learned reward says now."""
        if self._twin is not None:
            self._twin.load_state_dict(self.learner.reward.state_dict())

    def ask(self, step: int) -> None:
        since = step - self._first
        if since < 0 or since % self._config.every or self.queries >= self._config.budget:
            return
        if self.journal.asked_at == step:
            return
        count = self._config.session_size(step, self._steps, self.queries)
        pairs = select(
            self._config, count,
            segment=self._length, experience=self._experience, reward=self.learner.reward,
            labelled=self.preferences.pairs, rng=self._rng, first=self.queries == 0,
        )  # fmt: skip
        if unlabelled := self.learner.needs.unlabelled * count:
            episodes = self._experience.episodes[-self._config.window :]
            self.unlabelled.put(uniform_pairs(episodes, self._length, unlabelled, self._unlabelled_rng))
        margin = self.learner.needs.margin  # the teacher sees the middle of what the learner sees
        self.teacher.ask(self.journal.ask(self._experience, pairs + margin, self._config.segment, step))

    def waiting(self) -> str | None:
        if self.journal.asked_at is None:
            return None
        for answer in self.teacher.answers():
            self.journal.answer(answer)
        missing = len(self.journal.open)
        return f"{missing} answers of its teacher" if missing else None

    def attend(self, step: int, agent: Agent) -> None:
        """Fit the reward to the answers of the session asked for before this step, and relabel."""
        if self.journal.asked_at != step:
            return
        if step == self._first:
            self.learner.reward.begin(self._experience.near.obs[: self._experience.rows])
            self._imitate()
        pairs, preference = self.journal.apply(step)
        given = ~np.isnan(preference)
        self.preferences.add(pairs[given] - self.learner.needs.margin, preference[given])
        if not len(self.preferences):
            return
        if self._sight is not None:
            self._sight.renew(cast("VisualAgent", agent).encoder)
        self._label_accuracy = self.learner.fit(self.feedback)["label_accuracy"]
        self.relabel()

    def batch(self, agent: Agent) -> Batch:
        """Transitions; before some updates the learner wants the critic first, and the rewards are those after it."""
        step, needs = self._replay.steps, self.learner.needs
        spent = self.queries >= self._config.budget and not needs.refine_when_spent
        if step <= self._first or step % needs.refine_every or spent:
            return self._replay.sample()
        batch = self._replay.sample(time_limits_end=needs.time_limits_end)
        if not self.learner.refine(batch, cast("CriticAgent", agent), self.feedback):
            return batch
        self.relabel()
        return batch._replace(reward=self.learner.reward.predict(batch.obs, batch.act, batch.prior))

    def relabel(self) -> None:
        """Give every stored transition the reward as it is learned now, on the prior stored with it."""
        self._imitate()
        self._experience.relabel(self.learner.reward.predict)

    def episode_over(self, true_return: float, length: int) -> None:
        self.teacher.observe_return(true_return, length)

    def figures(self, rng: np.random.Generator) -> Mapping[str, float]:
        """`label_accuracy`: agreement with the labels during the last epoch of the last training, NaN before;
        `true_accuracy`: with the true reward, on fresh pairs; and the learner's own.
        """
        accuracy = {"label_accuracy": self._label_accuracy, "true_accuracy": self._true_accuracy(rng)}
        return accuracy | self.learner.metrics()

    def _true_accuracy(self, rng: np.random.Generator) -> float:
        """Agreement of the reward with the true one on 256 fresh uniform pairs, ties of the true return left out."""
        length = self._config.segment
        episodes = self._experience.episodes[-self._config.window :]
        if not episodes:
            return float("nan")
        pairs = uniform_pairs(episodes, length, _ACCURACY_PAIRS, rng)
        learned = self._experience.rewards(pairs, length).sum(-1, dtype=np.float64)
        true = self._experience.true_rewards(pairs, length).sum(-1, dtype=np.float64)
        clear = true[:, 0] != true[:, 1]
        agree = (learned[:, 0] < learned[:, 1]) == (true[:, 0] < true[:, 1])
        return float(agree[clear].mean()) if clear.any() else float("nan")

    def weights(self) -> State:
        reward = {"reward": self.learner.reward.state_dict()}
        return reward if self._sight is None else reward | {"sight": self._sight.state_dict()}

    legacy = weights  #: the reward as it was learned

    def state_dict(self) -> State:
        return {
            "learner": self.learner.state_dict(),
            "teacher": self.teacher.state_dict(),
            "preferences": self.preferences.state_dict(),
            "unlabelled": self.unlabelled.state_dict(),
            "journal": self.journal.state_dict(),
            "label_accuracy": self._label_accuracy,
            "sight": None if self._sight is None else self._sight.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        self.learner.load_state_dict(state["learner"])
        self._imitate()
        self.teacher.load_state_dict(state["teacher"])
        self.preferences.load_state_dict(state["preferences"])
        self.unlabelled.load_state_dict(state["unlabelled"])
        self.journal.load_state_dict(state["journal"])
        self._label_accuracy = float(state["label_accuracy"])
        if self._sight is not None:
            self._sight.load_state_dict(state["sight"])
        self.teacher.ask(self.journal.open)
