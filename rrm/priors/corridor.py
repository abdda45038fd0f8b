"""The penalty proxy of tasks with pictures (appendix, "Prior rewards"): stay in a corridor to object and goal.

The corridor is the union of two cuboids, 0.2 m wide and high, around the segments from the hand's start to the object's
and from there to the goal. The paper says no more of them. Here two faces of each are vertical, and each goes on for
half its width behind either end of its segment, so that the two leave no gap where the way bends.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from rrm.priors.proxy import needs

if TYPE_CHECKING:
    from rrm.priors.step import Position, PriorStep

HALF = 0.1  #: of the width, metres


@needs(("hand", "object_start", "goal"))
def penalty(step: PriorStep) -> float:
    """-1 where the hand is outside the corridor before the step, else 0. Where the object is now plays no part."""
    corners = (step.first.hand, step.object_start, step.goal)
    return 0.0 if any(inside(step.hand, *ends) for ends in pairwise(corners)) else -1.0


def inside(point: Position, begin: Position, end: Position) -> bool:
    """Whether a point [3] is in the cuboid around a segment, its surface included."""
    way = end - begin
    level, length = math.hypot(way[0], way[1]), math.hypot(*way)
    along = way / length if length else np.array([1.0, 0.0, 0.0])
    side = np.array([-way[1], way[0], 0.0]) / level if level else np.array([0.0, 1.0, 0.0])
    off = point - (begin + end) / 2
    return bool(
        abs(off @ along) <= length / 2 + HALF and abs(off @ side) <= HALF and abs(off @ np.cross(along, side)) <= HALF
    )
