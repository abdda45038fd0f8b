"""The prior's scale, from the values seen so far. A transition keeps what it was given; nothing is scaled anew later.

The appendix divides by the running standard deviation where that exceeds 1, and never shifts: a shift is invisible to
preferences over segments of equal length, and enlarging a small prior could carry it beyond the residual's reach. The
main text writes a z-score. Both update with the new value first and then apply.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from rrm.errors import UnknownNameError
from rrm.moments import RunningMoments
from rrm.types import State

_EPSILON = 1e-8  # of the z-score; the paper names it and gives no value


class Normaliser(ABC):
    """Turns a raw prior into the one that is stored, and learns from it."""

    def __init__(self) -> None:
        self._moments = RunningMoments()

    def __call__(self, raw: float) -> float:
        """Count `raw` in, then scale it."""
        self._moments.add(raw)
        return self.scaled(raw)

    @abstractmethod
    def scaled(self, raw: float) -> float:
        """Scale it by what was seen so far."""

    def state_dict(self) -> State:
        return self._moments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._moments.load_state_dict(state)


class ScaleNormaliser(Normaliser):
    """N(x) = x / max(1, sigma), the appendix' version."""

    def scaled(self, raw: float) -> float:
        return raw / max(1.0, self._moments.std)


class ZScoreNormaliser(Normaliser):
    """N(x) = (x - mu) / (sigma + epsilon), the main text's version."""

    def scaled(self, raw: float) -> float:
        return (raw - self._moments.mean) / (self._moments.std + _EPSILON)


def make_normaliser(name: str) -> Normaliser:
    """A fresh normaliser: "scale" (appendix) or "zscore" (main text)."""
    normalisers: dict[str, type[Normaliser]] = {"scale": ScaleNormaliser, "zscore": ZScoreNormaliser}
    if name not in normalisers:
        raise UnknownNameError("normaliser", name, normalisers)
    return normalisers[name]()
