"""What runs are called in their experiment, for people and in every table."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

#: What stands for teacher and feedback where nothing is asked; such runs belong to every panel of their task.
NOTHING_ASKED = "-"
ORACLE = "oracle"
#: The teacher that is people.
HUMAN = "human"
_DEPLOYED = " deployed"

_NUMBER = r"([1-9][0-9]{0,17})"
_SCHEDULE = re.compile(rf"{_NUMBER}@{_NUMBER}/{_NUMBER}(?: (.+))?")


def deployed(method: str) -> str:
    """What the deployments of a method's policies are called."""
    return f"{method}{_DEPLOYED}"


def policy(method: str) -> str:
    """The method whose policies are deployed under this name; another method's own."""
    return method.removesuffix(_DEPLOYED)


def knows(method: str) -> bool:
    """Whether a method learns from the true reward: the oracle, or a variant of it such as oracle-bfloat16."""
    return method.partition("-")[0] == ORACLE


class Label(NamedTuple):
    """What the runs of a row of the grid are called, whatever their seed."""

    task: str
    method: str
    teacher: str = NOTHING_ASKED
    feedback: str = NOTHING_ASKED

    @property
    def asked(self) -> tuple[str, ...]:
        """Teacher and feedback where they say something."""
        return tuple(word for word in (self.teacher, self.feedback) if word not in ("", NOTHING_ASKED))

    @property
    def words(self) -> tuple[str, ...]:
        """Task, method, and teacher and feedback where they say something."""
        return (self.task, self.method, *self.asked)

    @property
    def place(self) -> str:
        """`task (teacher, feedback)`: where methods are compared."""
        return f"{self.task} ({', '.join(self.asked)})" if self.asked else self.task

    def __str__(self) -> str:
        return f"{self.task}, {self.method}" + (f" ({', '.join(self.asked)})" if self.asked else "")

    def seeded(self, seed: int) -> str:
        """What one run is called: `task method teacher feedback seed 3`."""
        return " ".join([*self.words, f"seed {seed}"])


class Schedule(NamedTuple):
    """Of feedback, as its label says: `50@5000/5000`, and a name where more is set than these."""

    batch: int  #: queries of a session
    every: int  #: steps between sessions
    budget: int  #: queries in all
    name: str = ""

    def __str__(self) -> str:
        return f"{self.batch}@{self.every}/{self.budget} {self.name}".rstrip()

    @classmethod
    def of(cls, label: str) -> Schedule | None:
        """The schedule that a label stands for; None where it is none's, such as that of nothing asked."""
        match = _SCHEDULE.fullmatch(label)
        return match and cls(int(match[1]), int(match[2]), int(match[3]), match[4] or "")


def panels(labels: Iterable[Label]) -> dict[tuple[str, str, str], list[Label]]:
    """What is compared with one another, by task, teacher and feedback; what asks nothing is in all of its task."""
    distinct, compared = list(dict.fromkeys(labels)), {}
    for task in dict.fromkeys(label.task for label in distinct):
        here = [label for label in distinct if label.task == task]
        silent = (NOTHING_ASKED, NOTHING_ASKED)
        for where in dict.fromkeys(label[2:] for label in here if label.teacher != NOTHING_ASKED) or {silent: None}:
            compared[task, *where] = [label for label in here if label[2:] in (where, silent)]
    return compared
