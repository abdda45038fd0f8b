"""How a schedule of feedback is written in a label, and read again."""

from __future__ import annotations

import re
from typing import NamedTuple

_LABEL = re.compile(r"(\d+)@(\d+)/(\d+)(?: (.+))?")


class Schedule(NamedTuple):
    """Of feedback, as its label says: `50@5000/5000`, and a name where more is set than these."""

    batch: int  #: queries of a session
    every: int  #: steps between sessions
    budget: int  #: queries in all
    name: str = ""

    def __str__(self) -> str:
        label = f"{self.batch}@{self.every}/{self.budget}"
        return f"{label} {self.name}" if self.name else label

    @classmethod
    def of(cls, label: str) -> Schedule:
        """The schedule that a label stands for.

        Raises:
            ValueError: it is no label of a schedule, such as "-" where nothing is asked.
        """
        match = _LABEL.fullmatch(label)
        if match is None:
            raise ValueError(f'"{label}" is no schedule of feedback')
        batch, every, budget, name = match.groups()
        return cls(int(batch), int(every), int(budget), name or "")
