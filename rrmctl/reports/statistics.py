"""How the statistics of every report are made, and how wide its figures are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
    width: Width = "page"
    plus_minus: bool = False  #: the paper's form of a table that has one: half an interval's width behind a sign


DEFAULTS = Statistics()
