# /// language-prior
# task = "button-press"
# model = "stand-in"
# date = "2026-11-22"
# prompt_sha256 = "037889de2067b7ddb9d40883a30fef858ee80a11d5f7de68e50a3a38920a2a59"
# kept = "button-press.py"
# note = "not the paper's, whose function for this task is not published; written for this project by a language model to answer the prompt with its skeleton; the suite's reward was not used"
#
# [[candidates]]
# file = "button-press.py"
# sha256 = "49e55e3c51d354b0eaefcf1a0c876c54249cc375c436f909670277e0f37dc07b"
# ///

import numpy as np


def reward(step):
    """Bring the hand to the button, then push the button along y into its hole."""
    reach = np.linalg.norm(step.hand - step.object)
    left = abs(step.object[1] - step.goal[1])
    travel = abs(step.first.object[1] - step.goal[1]) + 1e-6

    near = 1.0 - np.tanh(5.0 * reach)
    pressed = np.clip(1.0 - left / travel, 0.0, 1.0)

    if pressed > 0.9:
        return 1.0
    if reach < 0.08:
        # at the button: what counts is how far it is in
        return 2.0 * (0.4 + 0.5 * pressed) - 1.0
    return 2.0 * (0.3 * near + 0.1 * pressed) - 1.0
