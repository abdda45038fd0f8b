"""The simulated arm in tests: skipped, with the reason, where PyBullet is not; and hand-written policies."""

import math
from importlib.util import find_spec

import numpy as np
import pytest

robot = pytest.mark.skipif(
    find_spec("pybullet") is None,
    reason="PyBullet is not installed: pip install 'rrmctl[robot]'; beyond Python 3.11 it has no wheel",
)


def scripted(task):
    """A policy, from observation to action, that succeeds; it remembers nothing."""
    way = {"panda-reach": _reach, "panda-push": _push, "panda-pick-and-reach": _pick}[task]

    def act(obs):
        act = 50 * way(obs.astype(np.float64))
        return (act / max(1.0, np.abs(act).max())).astype(np.float32)

    return act


def _reach(obs):
    return obs[3:6] - obs[:3] + np.array((0, 0, 0.045))


def _push(obs):
    """Around the cube to the side away from the goal, then on through it."""
    hand, cube, goal = obs[:2], obs[2:4], obs[5:7]
    left, off = goal - cube, hand - cube
    if np.linalg.norm(left) < 0.025:
        return np.zeros(2)
    behind = math.atan2(*-left[::-1])
    turn = math.remainder(math.atan2(*off[::-1]) - behind, math.tau)
    if abs(turn) > 0.4:
        at = behind + turn - math.copysign(min(abs(turn), 0.7), turn)
        return cube + 0.08 * np.array((math.cos(at), math.sin(at))) - hand
    return cube + 0.3 * left - hand


def _pick(obs):
    """Above the cube, down to it; once it is between the fingers, to the goal."""
    hand, cube, goal = obs[:3], obs[3:6], obs[7:10]
    aside = np.linalg.norm((cube - hand)[:2])
    if np.linalg.norm(cube - hand) < 0.02:
        return 0.3 * (goal - cube)
    return cube - hand if aside < 0.01 else np.array((*(cube - hand)[:2], max(0.0, 0.09 - hand[2])))
