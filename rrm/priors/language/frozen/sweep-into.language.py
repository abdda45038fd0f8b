# /// language-prior
# task = "sweep-into"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "4798ec625e4f321bdd87015dd31e4f27005e5874b10abc90ac88160c13a15543"
# kept = "sweep-into.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "sweep-into.py"
# sha256 = "56444fc59892e4bb8b55e66ad789aca4e04c4d087fe7387c6d3ac9501d85bf22"
# ///

import numpy as np


def reward(step):
    """Lower the hand to the puck, then sweep the puck over the table to the hole."""
    reach = np.linalg.norm(step.hand - step.object)
    left = np.linalg.norm(step.object[:2] - step.goal[:2])
    travel = np.linalg.norm(step.first.object[:2] - step.goal[:2]) + 1e-6
    swept = np.clip(1.0 - left / travel, -1.0, 1.0)
    near = np.exp(-5.0 * reach)

    if left < 0.04:
        return 1.0
    if swept < 0.0:
        # pushed away from the hole
        return np.clip(2.0 * 0.3 * near - 1.0 + 0.3 * swept, -1.0, 1.0)
    return 2.0 * (0.3 * near + 0.6 * swept) - 1.0
