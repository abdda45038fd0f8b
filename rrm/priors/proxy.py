"""Heuristic priors of the paper (appendix, priors of the state-based tasks) and its controls zero, opposite and random.

Distances are Euclidean, in metres, and taken in the state before the step; the success flag is the step's outcome.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rrm.priors.step import PriorStep

Prior = Callable[["PriorStep"], float]


def needs(*alternatives: tuple[str, ...]) -> Callable[[Prior], Prior]:
    """Declare what a prior reads: all names, as in `Task.reveals`, of one of the alternatives must be revealed."""

    def declare(prior: Prior) -> Prior:
        prior.needs = alternatives  # type: ignore[attr-defined]
        return prior

    return declare


@needs(("hand", "object", "goal"), ("upright",))
def proxy(step: PriorStep) -> float:
    """The main prior: -|object - goal| - |hand - object|, or (z - 1) / 2 where the task reveals the uprightness z."""
    if step.reveals("upright"):
        return (step.upright - 1) / 2
    return o2g(step) + h2o(step)


@needs(("object", "goal"))
def o2g(step: PriorStep) -> float:
    """-|object - goal|."""
    return -math.dist(step.object, step.goal)


@needs(("hand", "object"))
def h2o(step: PriorStep) -> float:
    """-|hand - object|."""
    return -math.dist(step.hand, step.object)


@needs(("hand", "goal"))
def one_dimension(step: PriorStep) -> float:
    """-|hand - goal| along y alone: a hint that leaves most of the task to the residual."""
    return -abs(float(step.hand[1] - step.goal[1]))


@needs(("success",))
def sparse(step: PriorStep) -> float:
    """1 for a step with success, else 0; among obstacles the paper's toy prior (appendix, "A toy example").

    That one is -1 within 0.1 m of an obstacle, else 10 within 0.5 m of the goal, else 0, in the state before the step.
    """
    if not step.reveals("clearance"):
        return step.success
    if step.clearance < 0.1:
        return -1.0
    return 10.0 if math.dist(step.object, step.goal) < 0.5 else 0.0


@needs(())
def zero(step: PriorStep) -> float:  # noqa: ARG001  (a prior takes the step, whether or not it looks)
    """0: the residual alone, with its bound."""
    return 0.0


@needs(("hand", "object", "goal"), ("upright",))
def opposite(step: PriorStep) -> float:
    """The proxy with its sign turned: it praises what is to be avoided."""
    return -proxy(step)


@needs(())
def random(step: PriorStep) -> float:
    """Uniform in (-1, 1), the scale of the residual; one draw per transition, stored with it."""
    return float(step.rng.uniform(-1.0, 1.0))
