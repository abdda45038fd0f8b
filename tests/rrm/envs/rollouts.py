"""Rolling an environment out under fixed random actions, here and in another process.

As a program: reads encoded states from the files named, one per task, continues each, and writes digests as JSON.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np

from rrm.checkpoint import decode
from rrm.envs import make, task
from rrm.envs.base import TaskEnv

HORIZON = 30


def actions(name: str, count: int, seed: int) -> np.ndarray:
    """Uniform actions float32 [count, A]."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, task(name).spaces.act)).astype(np.float32)


def roll(env: TaskEnv, acts: np.ndarray) -> list:
    """Everything the environment says under these actions, with resets where an episode ends."""
    heard = []
    for act in acts:
        obs, reward, terminated, truncated, info = env.step(act)
        heard.append((obs.tolist(), reward, terminated, truncated, info))
        if truncated:
            heard.append(env.reset()[0].tolist())
    return heard


def digest(heard: list) -> str:
    """Changes with any bit of any number."""
    return hashlib.sha256(json.dumps(heard).encode()).hexdigest()


def continued(name: str, file: Path) -> str:
    """Digest of steps into the next episode from the state in the file."""
    env = make(name, horizon=HORIZON)
    env.load_state_dict(decode(file.read_bytes()))
    return digest(roll(env, actions(name, HORIZON + 5, seed=2)))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    sys.stdout.write(json.dumps({name: continued(name, folder / name) for name in sys.argv[2:]}))
