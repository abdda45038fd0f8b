"""What a table with an arm and a cube consists of, wherever it stands. No simulator is imported here.

Metres, seconds, kilograms, radians; the table's top is z = 0, the arm stands at the origin and looks along x. The hand
always points down: its position is that of the grasp target between the fingers, whose tips are 1.1 cm lower.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np

RATE = 20  #: commands a second
TIP = 0.011  #: from the hand's position down to the tips of its fingers

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Physics:
    """What differs between one set-up and another."""

    cube_size: float = 0.05  #: side
    cube_mass: float = 0.1
    friction: float = 0.6  #: of the cube on table and fingers
    latency: int = 0  #: commands that lie between one that is given and its effect
    noise: float = 0.0  #: standard deviation of the cube's observed position; its yaw's is that over half its side
    damping: float = 0.04  #: share of the cube's speed that is lost in a second of free flight
    gain: float = 0.1  #: of the joints' motors: share of the way to their target made up in a simulated step
    substeps: int = 12  #: simulated steps of a command


@dataclass(frozen=True, slots=True)
class Limits:
    """The box that the hand does not leave. A cube whose centre is `margin` beyond it, or under the table, is lost."""

    low: Vector = (0.32, -0.28, 0.02)
    high: Vector = (0.68, 0.28, 0.30)
    margin: float = 0.08


class Pose(NamedTuple):
    """Of the cube: where its centre is, and its turn around the vertical, in [-pi, pi], whichever side is up."""

    position: Vector
    yaw: float


def lying(x: float, y: float, yaw: float, physics: Physics) -> Pose:
    """The pose of a cube on the table."""
    return Pose((x, y, physics.cube_size / 2), yaw)


def varied(ranges: Mapping[str, tuple[float, float]], rng: np.random.Generator) -> Physics:
    """The usual physics, with some of it drawn, uniformly, from its range; a range of one value takes no draw."""
    usual = Physics()
    drawn: dict[str, Any] = {}
    for name, (low, high) in ranges.items():
        if low == high:
            drawn[name] = low
        elif isinstance(getattr(usual, name), int):
            drawn[name] = int(rng.integers(int(low), int(high), endpoint=True))
        else:
            drawn[name] = float(rng.uniform(low, high))
    return replace(usual, **drawn)
