"""Episodes of a policy, recorded as demonstrations."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rrm.checkpoint import again, read_networks
from rrm.envs import make
from rrm.envs.base import TaskEnv
from rrm.errors import DemosError, MissingResultError
from rrm.imitation.demos import Demonstrations
from rrm.seeding import Streams
from rrm.training.build import build_agent
from rrm.training.run_config import RunConfig
from rrm.types import Floats, Obs

Policy = Callable[[Floats], Floats]


def expert_policy(config: RunConfig, model: Path) -> Policy:
    """The deterministic policy of a finished run, from the networks it left in the file `model`."""
    agent = build_agent(config, Streams(config.seed))
    networks = read_networks(model, "the expert's networks")
    if "agent" not in networks:
        raise MissingResultError(f"{model} does not hold the expert's networks: {again(model)}")
    agent.load_state_dict(networks["agent"])
    return lambda obs: agent.act(Obs(obs), explore=False)


def demonstrate(
    task: str,
    policy: Policy,
    episodes: int,
    *,
    seed: int,
    source: Mapping[str, Any],
    horizon: int | None = None,
    least_success: float = 0.0,
    stopped: Callable[[int, float], bool] = lambda _step, _rate: False,
) -> Demonstrations | None:
    """Play episodes of a task and record them; None where it was stopped.

    Args:
        seed: the stream `demonstrations` of it draws the instances.
        source: what to say of the policy in the provenance.
        horizon: steps of an episode where shorter than the task's own.
        least_success: share of the episodes that must succeed (else `DemosError`), where the task has that notion.
        stopped: asked after every episode with the steps so far and steps per second.
    """
    env, rng, began = make(task, horizon), Streams(seed).numpy("demonstrations"), time.monotonic()
    played: list[dict[str, Any]] = []
    step = 0
    try:
        for _ in range(episodes):
            played.append(_episode(env, policy, int(rng.integers(2**31))))
            step += len(played[-1]["obs"])
            if stopped(step, step / (time.monotonic() - began)):
                return None
    finally:
        env.close()
    steps = {
        name: np.concatenate([episode[name] for episode in played]) for name in ("obs", "act", "next_obs", "terminated")
    }
    demos = Demonstrations(
        **steps,
        lengths=np.array([len(episode["obs"]) for episode in played], np.int64),
        returns=np.array([episode["return"] for episode in played], np.float64),
        successes=np.array([episode["success"] for episode in played], np.float64),
        provenance={"task": task, "seed": seed, **source},
    )
    if demos.success < least_success:
        raise DemosError(
            f"the expert succeeds in {demos.success:.0%} of {episodes} episodes of {task}, {least_success:.0%} are "
            "asked for: train it longer, ask for less with imitation.expert_success, or name a file of your own with "
            "imitation.demos"
        )
    return demos


def _episode(env: TaskEnv, policy: Policy, seed: int) -> dict[str, Any]:
    columns: dict[str, list[Any]] = {"obs": [], "act": [], "next_obs": [], "terminated": []}
    obs, _ = env.reset(seed=seed)
    total, success, over = 0.0, -np.inf, False
    while not over:
        act = np.clip(policy(obs), -1.0, 1.0).astype(np.float32)
        next_obs, reward, terminated, truncated, info = env.step(act)
        for name, value in (("obs", obs), ("act", act), ("next_obs", next_obs), ("terminated", terminated)):
            columns[name].append(value)
        total += reward
        success = max(success, float(info["success"])) if "success" in info else np.nan
        obs, over = next_obs, terminated or truncated
    kinds = {"terminated": np.uint8}
    arrays = {name: np.array(values, kinds.get(name, np.float32)) for name, values in columns.items()}
    return arrays | {"return": total, "success": success}
