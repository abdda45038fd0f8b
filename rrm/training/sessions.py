"""Feedback sessions: choose queries, ask the teacher, fit the reward, relabel (algorithm 1, lines 4 to 14)."""

from __future__ import annotations

import numpy as np

from rrm.buffers.experience import Experience
from rrm.buffers.preferences import SKIPPED, LabelledSegments, Preferences
from rrm.config import FeedbackConfig
from rrm.interfaces import RewardLearner, Teacher
from rrm.queries import select, uniform_pairs
from rrm.training.config import RunConfig
from rrm.types import State

_ACCURACY_PAIRS = 256


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
    ) -> None:
        """Args: rng: the stream that draws candidate segments."""
        self._run = run
        self._config = config
        self._experience = experience
        self.teacher = teacher
        self._rng = rng
        self.learner = learner
        self.preferences = Preferences(run.reward.capacity, config.segment)
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
            experience=self._experience, reward=self.learner.reward, labelled=self.preferences.pairs, rng=self._rng,
            first=self.requested == 0,
        )  # fmt: skip
        length = self._config.segment
        labels = self.teacher.label((
            self._experience.true_rewards(pairs[:, 0], length),
            self._experience.true_rewards(pairs[:, 1], length),
        ))  # fmt: skip
        answered = labels != SKIPPED
        self.preferences.add(pairs[answered], labels[answered])
        self.requested += count
        self.labelled += int(answered.sum())
        if len(self.preferences):
            metrics = self.learner.fit(LabelledSegments(self._experience, self.preferences))
            self.label_accuracy = metrics["label_accuracy"]
            self.relabel()

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
            "requested": self.requested,
            "labelled": self.labelled,
            "label_accuracy": self.label_accuracy,
        }

    def load_state_dict(self, state: State) -> None:
        self.learner.load_state_dict(state["learner"])
        self.teacher.load_state_dict(state["teacher"])
        self.preferences.load_state_dict(state["preferences"])
        self.requested = int(state["requested"])
        self.labelled = int(state["labelled"])
        self.label_accuracy = float(state["label_accuracy"])
