# /// language-prior
# task = "walker-walk"
# model = "GPT-5"
# date = "unknown, before the paper"
# prompt_sha256 = "45ae32400ab148585e623c78108714a7896ed1fc1927a56c8a1dc3395c158711"
# kept = "walker-walk.py"
# note = "as printed in the paper (appendix, Language rewards), in terms of a step's accessors; range [0, 2]; the prompt is rrmctl's, after the paper's; scores of the paper's candidates are not published"
#
# [[candidates]]
# file = "walker-walk.py"
# sha256 = "8077e743cc893d600b081be1d45277424ec3cbb2ceefd8f22cf4d0bf9b6a5971"
# ///

import numpy as np

_STAND_HEIGHT = 1.2
_WALK_SPEED = 1.0
_WALK_SIGMA = 0.25  # tolerance for Gaussian shaping


def _gaussian(x, mu, sigma):
    return np.exp(-0.5 * ((x - mu) / sigma) ** 2)


def reward(step):
    # --- 1. Forward velocity tracking ---
    r_velocity = _gaussian(step.forward_velocity, _WALK_SPEED, _WALK_SIGMA)
    # --- 2. Upright posture reward ---
    r_upright = (step.torso_upright + 1) / 2.0
    # --- 3. Height reward (stay near stand height) ---
    r_height = _gaussian(step.torso_height, _STAND_HEIGHT, 0.2)
    # --- Final reward as weighted sum ---
    return float(1.0 * r_velocity + 0.5 * r_upright + 0.5 * r_height)
