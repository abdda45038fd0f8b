"""Evaluation on an environment and random streams of its own, so that it cannot disturb training."""

from __future__ import annotations

import numpy as np

from rrm.config import EvaluationConfig
from rrm.envs.observer import Observer
from rrm.interfaces import Agent
from rrm.seeding import evaluation_seed
from rrm.types import Evaluation


def evaluate(agent: Agent, env: Observer, config: EvaluationConfig, *, seed: int, step: int) -> Evaluation:
    """Play `config.episodes` episodes; the instances depend on the run's seed, the step and the episode alone."""
    episodes = [_episode(agent, env, evaluation_seed(seed, step, number)) for number in range(config.episodes)]
    successes = [flags[-1] if config.success == "last" else float(np.max(flags)) for _, flags in episodes]
    return Evaluation(float(np.mean([total for total, _ in episodes])), float(np.mean(successes)))


def _episode(agent: Agent, env: Observer, seed: int) -> tuple[float, list[float]]:
    obs = env.reset(seed=seed)
    total, flags, over = 0.0, [], False
    while not over:
        obs, reward, terminated, truncated, info = env.step(agent.act(obs, explore=False))
        total += reward
        flags.append(float(info.get("success", np.nan)))
        over = terminated or truncated
    return total, flags
