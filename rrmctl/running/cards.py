"""Which of this machine's graphics cards a run is trained on: one card a run, several runs a card."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

#: By this variable a process is told which cards there are.
VISIBLE = "CUDA_VISIBLE_DEVICES"

#: With this, products on a card are the same each time ("Results reproducibility" in the documents of cuBLAS). It is
#: all that a process on a card is told where something else says which: a batch system, a cluster, the user.
REPEATABLE = {"CUBLAS_WORKSPACE_CONFIG": ":4096:8"}

#: A process that is told so finds no card, and takes none of its memory.
NO_CARD = {VISIBLE: ""}


def names(count: int, base: Mapping[str, str] = os.environ) -> list[str]:
    """What `CUDA_VISIBLE_DEVICES` calls the cards that CUDA lists here, so many, in its order.

    Where the user has set it, those are a part of the machine's, and only that list says which.
    """
    listed = base.get(VISIBLE)
    words = map(str, range(count)) if listed is None else (word.strip() for word in listed.split(","))
    return list(words)[:count]


@dataclass
class Cards:
    """The cards that runs may use, and who is on them."""

    rooms: Mapping[str, int]  #: how many runs a card takes at a time, by its name in `CUDA_VISIBLE_DEVICES`
    variables: Mapping[str, str] = field(default_factory=dict)  #: that those who are on a card are told besides
    _on: dict[str, str] = field(default_factory=dict, init=False)  # the card, by run

    @property
    def places(self) -> int:
        """How many runs they take at a time."""
        return sum(self.rooms.values())

    def take(self, run: str) -> dict[str, str]:
        """Give a run a place on the card that has the fewest. Returns the variables by which its process finds it."""
        load = Counter(self._on.values())
        free = [card for card, room in self.rooms.items() if load[card] < room]
        self._on[run] = card = min(free, key=load.__getitem__)
        return {VISIBLE: card, **REPEATABLE, **self.variables}

    def free(self, run: str) -> None:
        """The run has left its card, if it was on one."""
        self._on.pop(run, None)
