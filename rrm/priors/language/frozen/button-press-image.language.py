# /// language-prior
# task = "button-press-image"
# model = "GPT-5"
# date = "unknown, before the paper"
# prompt_sha256 = "833a2c4215c377366965149c1ea2d8d332746e0c48f2f78b10dcdd6e0aad634b"
# kept = "button-press-image.py"
# note = "the paper's formula (appendix, Language rewards, the two image-based tasks), in terms of a step's accessors; range [-1, 1]; the code is rrmctl's, so is the prompt, after the paper's; scores of the paper's candidates are not published"
#
# [[candidates]]
# file = "button-press-image.py"
# sha256 = "9f643ebe2e6cf7dc6016d59a6bc078f25bb596199243a98d73e0fe8ae57d25fa"
# ///

import numpy as np

_EPSILON = 1e-8


def reward(step):
    way = np.linalg.norm(step.hand - step.goal)
    whole = np.linalg.norm(step.goal - step.first.hand)
    return 2.0 * np.clip(1.0 - way / (whole + _EPSILON), 0.0, 1.0) - 1.0
