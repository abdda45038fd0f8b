"""The prior's scale, from the values seen so far. A transition keeps what it was given; nothing is scaled anew later.

The appendix divides by the running standard deviation where that exceeds 1, and never shifts: a shift is invisible to
preferences over segments of equal length, and enlarging a small prior could carry it beyond the residual's reach. The
main text writes a z-score. Both update with the new value first and then apply.
"""

from __future__ import annotations

from typing import Protocol

from rrm.errors import UnknownNameError
from rrm.moments import RunningMoments
from rrm.types import State

EPSILON = 1e-8  #: of the z-score; the paper names it and gives no value


class Normaliser(Protocol):
    """Turns a raw prior into the one that is stored, and learns from it."""

    def __call__(self, raw: float) -> float:
        """Count `raw` in, then scale it."""

    def scaled(self, raw: float) -> float:
        """Scale it by what was seen so far."""

    def state_dict(self) -> State:
        """What was seen so far."""

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken."""


class ScaleNormaliser:
    """N(x) = x / max(1, sigma), the appendix' version."""

    def __init__(self) -> None:
        self._moments = RunningMoments()

    def __call__(self, raw: float) -> float:
        self._moments.add(raw)
        return self.scaled(raw)

    def scaled(self, raw: float) -> float:
        return raw / max(1.0, self._moments.std)

    def state_dict(self) -> State:
        return self._moments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._moments.load_state_dict(state)


class ZScoreNormaliser:
    """N(x) = (x - mu) / (sigma + epsilon), the main text's version."""

    def __init__(self) -> None:
        self._moments = RunningMoments()

    def __call__(self, raw: float) -> float:
        self._moments.add(raw)
        return self.scaled(raw)

    def scaled(self, raw: float) -> float:
        return (raw - self._moments.mean) / (self._moments.std + EPSILON)

    def state_dict(self) -> State:
        return self._moments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._moments.load_state_dict(state)


_NORMALISERS: dict[str, type[ScaleNormaliser] | type[ZScoreNormaliser]] = {
    "scale": ScaleNormaliser,
    "zscore": ZScoreNormaliser,
}


def make_normaliser(name: str) -> Normaliser:
    """A fresh normaliser: "scale" (appendix) or "zscore" (main text).

    Raises:
        UnknownNameError: another name.
    """
    if name not in _NORMALISERS:
        raise UnknownNameError("normaliser", name, _NORMALISERS)
    return _NORMALISERS[name]()
