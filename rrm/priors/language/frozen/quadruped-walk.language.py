# /// language-prior
# task = "quadruped-walk"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "ed9afc57116b28d8cf2c28474d81344c63bd2386c2dfbc1d4665613b378226f1"
# kept = "quadruped-walk.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "quadruped-walk.py"
# sha256 = "fc7772a8050b57dd301979ff29b279c00a597783a839b08fa5b8d43ae0179fd0"
# ///

import numpy as np

WALK_SPEED = 0.5


def reward(step):
    """Get on the feet first; then walk forward at the desired speed, without wild actions."""
    upright = (step.torso_upright + 1.0) / 2.0
    effort = np.mean(np.square(step.act))

    if upright < 0.6:
        # lying or upside down: turning over is all that matters
        return upright - 1.0
    speed = np.exp(-(((step.forward_velocity - WALK_SPEED) / 0.3) ** 2))
    score = 0.4 * upright + 0.55 * speed + 0.05 * (1.0 - effort)
    return 2.0 * np.clip(score, 0.0, 1.0) - 1.0
