# /// language-prior
# task = "toy-car"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "c60401eb1d7555ab10c19686c2eb1bcb73fa2007410931e438e954506a811acc"
# kept = "toy-car.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "toy-car.py"
# sha256 = "72ee1630d3b24e9cff1dc74e80a2c150591fb8ca56340ec2897b44167dd90a20"
# ///

import numpy as np

GOAL_RADIUS = 0.5
DANGER = 0.1
CAUTION = 0.4


def reward(step):
    """Drive towards the goal, and keep away from the obstacles."""
    distance = np.linalg.norm(step.object - step.goal)
    start = np.linalg.norm(step.first.object - step.first.goal) + 1e-6

    if distance < GOAL_RADIUS:
        value = 1.0
    else:
        value = 0.8 - 1.6 * min(distance / start, 1.0)
    if step.clearance < DANGER:
        value -= 0.4
    elif step.clearance < CAUTION:
        value -= 0.2 * (CAUTION - step.clearance) / (CAUTION - DANGER)
    return np.clip(value, -1.0, 1.0)
