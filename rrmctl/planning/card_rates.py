"""What graphics cards were measured to do here: `rrmctl doctor --tune` measures, plans and the pool go by it.

Figures are kept beside those of products (`rrm.tuning`), in the user's cache folder: for a card of this name, this
processor and this torch.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from pydantic import PositiveInt, TypeAdapter

from rrm import files
from rrm.devices import Card
from rrm.hardware import cpu_model
from rrm.tuning import Rate, kept_in

#: So much more must twice as many runs make together to be worth it.
PAYS = 1.1

#: So much of a card's memory runs may take: what else there is on it varies.
_FILLED = 0.9


@dataclass(frozen=True)
class Rates:
    """What runs on one card make together."""

    steps_per_s: Mapping[PositiveInt, Rate]  #: environment steps a second of all together, by how many there are
    run_bytes: PositiveInt  #: of the card's memory, that one takes

    @property
    def best(self) -> int:
        """How many at a time pay: the most of which the last doubling was worth it."""
        counts = sorted(self.steps_per_s)
        best = counts[0]
        for count in counts[1:]:
            if self.steps_per_s[count] < PAYS * self.steps_per_s[best]:
                break
            best = count
        return best

    @property
    def each(self) -> float:
        """Environment steps a second of one of them, where so many as pay run at a time."""
        return self.steps_per_s[self.best] / self.best

    def fitting(self, memory: int) -> int:
        """How many fit into so many bytes."""
        return int(_FILLED * memory / self.run_bytes)


def place(card: Card, *, mps: bool = False) -> Path:
    """The file where the figures of a card are kept, or would be.

    Args: mps: of runs that NVIDIA's MPS has work at the same time; else they take turns.
    """
    facts = (card.name, card.memory, cpu_model(), version("torch"), *(("mps",) if mps else ()))
    return kept_in().with_name(f"card-{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}.json")


def read(card: Card, *, mps: bool = False) -> Rates | None:
    """What is kept; None where nobody has measured, or it cannot be read."""
    with suppress(OSError, ValueError):
        found = TypeAdapter(Rates).validate_json(files.read_bounded(place(card, mps=mps), 1 << 20))
        return found if found.steps_per_s else None
    return None


def keep(card: Card, rates: Rates, *, mps: bool = False) -> None:
    """Keep what was measured. Raises OSError."""
    path = place(card, mps=mps)
    files.make_folder(path.parent)
    files.write_atomically(path, json.dumps(asdict(rates), indent=1).encode())


def in_words(rates: Rates) -> str:
    """Such as `4 runs at a time (1: 310, 2: 600, 4: 1,050, 8: 1,090 steps/s together; 1.3 GiB each)`."""
    told = ", ".join(f"{count}: {rate:,.0f}" for count, rate in sorted(rates.steps_per_s.items()))
    times = f"{rates.best} run{'s' if rates.best > 1 else ''} at a time"
    return f"{times} ({told} steps/s together; {rates.run_bytes / 2**30:.1f} GiB each)"
