# /// language-prior
# task = "door-unlock"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "cd8851cc47760cf18198ecdc6bd5ae2e0cdfa92e704f3a0a55294f7d4cb58bd9"
# kept = "door-unlock.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "door-unlock.py"
# sha256 = "ab3699ba3d9f3273bed02eb8be7827955223148c2c9dd318a37d39d530e808a9"
# ///

import numpy as np


def reward(step):
    """Bring the hand to the lock's lever, then turn the lever until it stands at the goal."""
    reach = np.linalg.norm(step.hand - step.object)
    travel = np.linalg.norm(step.first.object - step.goal) + 1e-6
    turned = np.clip(1.0 - np.linalg.norm(step.object - step.goal) / travel, 0.0, 1.0)
    near = 1.0 / (1.0 + (reach / 0.1) ** 2)

    if turned > 0.85:
        return 1.0
    if turned > 0.05:
        # the lever has begun to move: keep it moving
        return 2.0 * (0.3 + 0.1 * near + 0.5 * turned) - 1.0
    return 2.0 * 0.3 * near - 1.0
