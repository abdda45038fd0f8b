# /// language-prior
# task = "door-open"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "189f608a95bfd17f1674d63819c97c55e5f23acc947149aea1e9a6a743198401"
# kept = "door-open.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "door-open.py"
# sha256 = "7a5b7a13d00ac20ce53ca4a2917856bd9c6fc167eaa22379dfa2c7d68b1077bf"
# ///

import numpy as np

HANDLE_RADIUS = 0.06


def reward(step):
    """Bring the hand to the handle, then move the handle along its arc to the goal."""
    reach = np.linalg.norm(step.hand - step.object)
    travel = np.linalg.norm(step.first.object - step.goal) + 1e-6
    opened = np.clip(1.0 - np.linalg.norm(step.object - step.goal) / travel, 0.0, 1.0)
    near = np.exp(-4.0 * reach)

    score = 0.35 * near + 0.5 * opened
    if reach < HANDLE_RADIUS:
        score += 0.05
    if opened > 0.85:
        score = 0.9 + 0.1 * near
    return 2.0 * np.clip(score, 0.0, 1.0) - 1.0
