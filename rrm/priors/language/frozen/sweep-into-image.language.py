# /// language-prior
# task = "sweep-into-image"
# model = "GPT-5"
# date = "unknown, before the paper"
# prompt_sha256 = "6187b6fba4699fe14fdceb71ca53ba6cbd56b728f9c189af41ea7c2246ae2167"
# kept = "sweep-into-image.py"
# note = "the paper's formula (appendix, Language rewards, the two image-based tasks), in terms of a step's accessors; range [-1, 1]; the code is rrmctl's, so is the prompt, after the paper's; scores of the paper's candidates are not published"
#
# [[candidates]]
# file = "sweep-into-image.py"
# sha256 = "e64efd2f5f990f74b9a9c72b83e3711f5c5fdf4e0dc4d786b9a3ef6212c95e3c"
# ///

import numpy as np

_EPSILON = 1e-8


def _covered(step, place):
    way = np.linalg.norm(step.hand - place)
    whole = np.linalg.norm(place - step.first.hand)
    return 1.0 - way / (whole + _EPSILON)


def reward(step):
    to_goal = _covered(step, step.goal)
    to_object = _covered(step, step.object_start)
    return 2.0 * np.clip(0.1 * to_goal + 0.9 * to_object, 0.0, 1.0) - 1.0
