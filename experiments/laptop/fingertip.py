"""The proxy with the fingertip as the end effector: Meta-World's hand is 4.5 cm above it."""

import math

from rrm.priors.step import PriorStep


def fingertip(step: PriorStep) -> float:
    """-|object - goal| - |fingertip - object|, metres."""
    x, y, z = step.hand
    return -math.dist(step.object, step.goal) - math.dist((x, y, z - 0.045), step.object)
