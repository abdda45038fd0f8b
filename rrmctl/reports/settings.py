"""How the statistics of every report are made."""

from __future__ import annotations

from dataclasses import dataclass

from rrmctl.stats import REPLICATES, IqmKind

#: Every interval is drawn from a generator of its own with this seed, so that a table depends on its runs alone.
BOOTSTRAP_SEED = 0
LEVEL = 0.95


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a reader may choose."""

    kind: IqmKind = "rliable"
    replicates: int = REPLICATES


DEFAULTS = Settings()
