"""What the simulated rig leaves of policies that succeed in the training's simulation: the most that a learned one can
hope for there, and what an episode costs.

The policies are hand-written, see `tests.robot.scripted`; the episodes of the simulation are of other instances.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec

import numpy as np

from benchmarks.lines import Line
from rrm.envs import make
from rrm.envs.tasks import ARM, TASKS
from rrm.robot.config import RigConfig
from rrm.robot.deployment import deploy
from rrm.robot.rig import Rig
from rrm.robot.setup import calibration, marked_cube
from tests.robot import scripted

EPISODES = 20


def lines(episodes: int = EPISODES, tasks: Sequence[str] = ()) -> list[Line]:
    """Args: how many each; which of the arm's tasks, by default all. Nothing where PyBullet is missing."""
    if find_spec("pybullet") is None:
        return []
    config = RigConfig()
    cameras, cube = calibration(config).cameras, marked_cube(config)
    out = []
    for task in tasks or [name for name in TASKS if name.startswith(f"{ARM}-")]:
        began = time.perf_counter()
        played = list(deploy(scripted(task), task, partial(Rig, config), cameras, cube, episodes=episodes, seed=0))
        took = (time.perf_counter() - began) / episodes
        failed, lost = (sum(map(bool, told)) for told in ([not e.success for e in played], [e.lost for e in played]))
        there = {"the training's simulation": 100 * np.mean([not succeeds(task, seed) for seed in range(episodes)])}
        note = f"of {episodes} by a hand-written policy; lost from sight {lost}"
        out.append(Line(item=f"{task}: failures", ours=100 * failed / episodes, unit="%", peers=there, note=note))
        out.append(Line(item=f"{task}: an episode at the rig", ours=took, unit="s"))
    return out


def succeeds(task: str, seed: int) -> bool:
    """Whether the policy's episode of this seed ends with success, in the simulation that policies are trained in."""
    env, policy, info = make(task), scripted(task), {}
    try:
        obs, _ = env.reset(seed=seed)
        for _ in range(env.horizon):
            obs, _, _, _, info = env.step(policy(obs))
    finally:
        env.close()
    return bool(info["success"])
