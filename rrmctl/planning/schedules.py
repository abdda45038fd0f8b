"""How a schedule of feedback is written in a label, and read again."""

from __future__ import annotations

import re
from typing import NamedTuple

_NUMBER = r"([1-9][0-9]{0,17})"
_LABEL = re.compile(rf"{_NUMBER}@{_NUMBER}/{_NUMBER}(?: (.+))?")


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
    def of(cls, label: str) -> Schedule | None:
        """The schedule that a label stands for; None where it is none's, such as that of nothing asked."""
        match = _LABEL.fullmatch(label)
        return match and cls(int(match[1]), int(match[2]), int(match[3]), match[4] or "")
