"""Feedback sessions: choose queries, ask the teacher, fit the reward, relabel (algorithm 1, lines 4 to 14)."""

from __future__ import annotations

import numpy as np

from rrm.buffers.experience import Experience
from rrm.buffers.preferences import SKIPPED, PairRing, Preferences, Rows, StoredFeedback
from rrm.config import FeedbackConfig
from rrm.interfaces import Agent, Floats, RewardLearner, Teacher
from rrm.queries import select, uniform_pairs
from rrm.training.config import RunConfig
from rrm.types import Batch, State

_ACCURACY_PAIRS = 256
_UNLABELLED_PAIRS = 500_000  # newest ones kept (SURF)


class Sessions:
    """The feedback of one run: when it is due, what was asked, and what is left of the budget."""

    def __init__(
        self,
        run: RunConfig,
        config: FeedbackConfig,
        *,
        experience: Experience,
        learner: RewardLearner,
        teacher: Teacher,
        rng: np.random.Generator,
        unlabelled_rng: np.random.Generator,
    ) -> None:
        """Args: rng, unlabelled_rng: the streams that draw candidate segments, and pairs nobody is asked about.

        Raises:
            ConfigError: segments with the learner's margins are longer than an episode.
        """
        run.check_margin(learner.needs.margin)
        self._run = run
        self._config = config
        self._experience = experience
        self.teacher = teacher
        self._rng = rng
        self.learner = learner
        self._unlabelled_rng = unlabelled_rng
        self._length = config.segment + 2 * learner.needs.margin  # steps of a segment as the learner sees it
        self.preferences = Preferences(run.reward.capacity, self._length)
        self.unlabelled = PairRing(_UNLABELLED_PAIRS, self._length)
        self._feedback = StoredFeedback(experience, self.preferences, self.unlabelled, config.batch)
        self.requested = 0  #: queries put so far, skipped ones included
        self.labelled = 0  #: labels given so far
        self.label_accuracy = float("nan")  #: of the last fit

    def due(self, step: int) -> bool:
        """True before the steps `first_session + i * every`, while there is budget."""
        since_first = step - self._run.first_session
        return since_first >= 0 and since_first % self._config.every == 0 and self.requested < self._config.budget

    def hold(self, step: int) -> None:
        """One session: queries, labels, training of the reward, new rewards for all that has been lived."""
        count = self._config.session_size(step, self._run.steps, self.requested)
        pairs = select(
            self._config, count,
            segment=self._length, experience=self._experience, reward=self.learner.reward,
            labelled=self.preferences.pairs, rng=self._rng, first=self.requested == 0,
        )  # fmt: skip
        self._draw_unlabelled(count)
        labels = self.teacher.label((self._true_rewards(pairs[:, 0]), self._true_rewards(pairs[:, 1])))
        answered = labels != SKIPPED
        self.preferences.add(pairs[answered], labels[answered])
        self.requested += count
        self.labelled += int(answered.sum())
        if len(self.preferences):
            metrics = self.learner.fit(self._feedback)
            self.label_accuracy = metrics["label_accuracy"]
            self.relabel()

    def _true_rewards(self, starts: Rows) -> Floats:
        """What the teacher judges: the middle of each segment, without the learner's margins."""
        return self._experience.true_rewards(starts + self.learner.needs.margin, self._config.segment)

    def _draw_unlabelled(self, queries: int) -> None:
        count = self.learner.needs.unlabelled * queries
        if count:
            episodes = self._experience.episodes[-self._config.window :]
            self.unlabelled.put(uniform_pairs(episodes, self._length, count, self._unlabelled_rng))

    def refinement_due(self, step: int) -> bool:
        """True before an update for which the learner wants the critic: every so many steps after the first session."""
        needs = self.learner.needs
        spent = self.requested >= self._config.budget
        return (
            step > self._run.first_session
            and step % needs.refine_every == 0
            and (needs.refine_when_spent or not spent)
        )  # fmt: skip

    def refine(self, batch: Batch, agent: Agent) -> Batch:
        """Let the learner use the critic; the batch, with the rewards as they are now."""
        if not self.learner.refine(batch, agent, self._feedback):
            return batch
        self.relabel()
        return batch._replace(reward=self.learner.reward.predict(batch.obs, batch.act, batch.prior))

    def relabel(self) -> None:
        """Give every stored transition the reward as it is learned now, on the prior stored with it."""
        self._experience.relabel(self.learner.reward.predict)

    def true_accuracy(self, rng: np.random.Generator) -> float:
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

    def state_dict(self) -> State:
        return {
            "learner": self.learner.state_dict(),
            "teacher": self.teacher.state_dict(),
            "preferences": self.preferences.state_dict(),
            "unlabelled": self.unlabelled.state_dict(),
            "requested": self.requested,
            "labelled": self.labelled,
            "label_accuracy": self.label_accuracy,
        }

    def load_state_dict(self, state: State) -> None:
        self.learner.load_state_dict(state["learner"])
        self.teacher.load_state_dict(state["teacher"])
        self.preferences.load_state_dict(state["preferences"])
        self.unlabelled.load_state_dict(state["unlabelled"])
        self.requested = int(state["requested"])
        self.labelled = int(state["labelled"])
        self.label_accuracy = float(state["label_accuracy"])
