"""How the statistics of every report are made, and how wide its figures are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from rrmctl.errors import UserError, shown
from rrmctl.stats import REPLICATES, IqmKind

#: Every interval is drawn from a generator of its own with this seed, so that a table depends on its runs alone.
BOOTSTRAP_SEED = 0
LEVEL = 0.95
#: As people read it.
SURE = f"{100 * LEVEL:g} %"

#: Of a figure: as wide as one column of a two-column paper, or at most as wide as its page.
Width = Literal["column", "page"]


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """What a reader may choose."""

    kind: IqmKind = "rliable"
    replicates: int = REPLICATES
    last: int = 1  #: evaluations up to a step, of which a run's score there is the mean
    width: Width = "page"
    plus_minus: bool = False  #: the paper's form of a table that has one: half an interval's width behind a sign

    def __post_init__(self) -> None:
        if self.last < 1:
            raise UserError(f"last={self.last}: a score is of one evaluation at least")

    @property
    def final(self) -> str:
        """What a score at a step is, in words, where it is not of one evaluation."""
        return f"mean of the last {self.last} evaluations"


DEFAULTS = Statistics()


def evaluations(final: str) -> int:
    """How many evaluations `last` or `mean-K` asks for; anything else is refused."""
    match = re.fullmatch(r"last|mean-0*([1-9][0-9]{0,17})", final, re.ASCII)
    if match is None:
        raise UserError(
            f"--final {shown(final)}: expected last or mean-K, K a number of evaluations from 1 on",
            "mean-5 takes the mean of the last five evaluations",
        )
    return int(match[1] or 1)
