# /// language-prior
# task = "window-open"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "64104ba16b5be69d0b109e25d8bc3b840a6fcf24bc7eed7fc76a43c72e2250d3"
# kept = "window-open.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "window-open.py"
# sha256 = "d2f6f5c55fd63198bf1d206fd49feec5cb5ccfe0922fd3d4f60818894497dba9"
# ///

import numpy as np

OPEN_TOLERANCE = 0.03


def reward(step):
    """Bring the hand to the handle, then slide the handle along x to the goal."""
    reach = np.linalg.norm(step.hand - step.object)
    left = abs(step.goal[0] - step.object[0])
    travel = abs(step.goal[0] - step.first.object[0]) + 1e-6
    near = 1.0 - np.tanh(4.0 * reach)
    slid = np.clip(1.0 - left / travel, 0.0, 1.0)

    if left < OPEN_TOLERANCE:
        return 1.0
    return 2.0 * (0.3 * near + 0.6 * slid) - 1.0
