"""Episodes of a policy: what it is worth, and recorded as demonstrations.

On environments and random streams of their own, so that they cannot disturb training.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rrm.buffers.frames import Frames
from rrm.checkpoint import again, read_networks
from rrm.config import EvaluationConfig
from rrm.devices import CPU
from rrm.envs.observer import Observer
from rrm.envs.tasks import Ranges
from rrm.errors import DemosError, MissingResultError
from rrm.imitation.demos import Demonstrations
from rrm.interfaces import Agent
from rrm.seeding import Streams, evaluation_seed
from rrm.training.build import build_agent
from rrm.training.run_config import RunConfig
from rrm.types import Evaluation, Floats, Obs

Policy = Callable[[Obs], Floats]


def evaluate(agent: Agent, env: Observer, config: EvaluationConfig, *, seed: int, step: int) -> Evaluation:
    """Play `config.episodes` episodes; the instances depend on the run's seed, the step and the episode alone."""
    totals: list[float] = []
    successes: list[float] = []
    for number in range(config.episodes):
        *_, (total, success) = play(deterministic(agent), env, config, evaluation_seed(seed, step, number))
        totals.append(total)
        successes.append(success)
    return Evaluation(float(np.mean(totals)), float(np.mean(successes)))


def play(policy: Policy, env: Observer, config: EvaluationConfig, seed: int) -> Iterator[tuple[float, float]]:
    """Play an episode: its return and success so far, at its beginning and after every action. Success is NaN where
    the task has no such notion, and at the beginning.
    """
    obs, total, success, over = env.reset(seed=seed), 0.0, np.nan, False
    yield total, success
    while not over:
        obs, reward, terminated, truncated, info = env.step(policy(obs))
        total, now = total + reward, float(info.get("success", np.nan))
        success = now if config.success == "last" else float(np.fmax(success, now))
        yield total, success
        over = terminated or truncated


def deterministic(agent: Agent) -> Policy:
    """What it does where it explores nothing."""
    return lambda obs: agent.act(obs, explore=False)


def expert_policy(config: RunConfig, model: Path) -> Policy:
    """The deterministic policy of a run, from the networks it left in the file `model`."""
    agent = build_agent(config.model_copy(update={"device": CPU}), Streams(config.seed))
    networks = read_networks(model, "the policy's networks")
    if "agent" not in networks:
        raise MissingResultError(f"{model} does not hold the policy's networks: {again(model)}")
    agent.load_state_dict(networks["agent"])
    return deterministic(agent)


def demonstrate(
    task: str,
    policy: Policy,
    episodes: int,
    *,
    seed: int,
    source: Mapping[str, Any],
    horizon: int | None = None,
    repeat: int = 1,
    ranges: Ranges | None = None,
    frames: Frames | None = None,
    by_state: bool = False,
    least_success: float = 0.0,
    stopped: Callable[[int, float], bool] = lambda _step, _rate: False,
) -> Demonstrations | None:
    """Play episodes of a task and record them; None where it was stopped.

    Args:
        seed: the stream `demonstrations` of it draws the instances.
        source: what to say of the policy in the provenance.
        horizon: steps of an episode where shorter than the task's own.
        repeat: steps of the environment that an action lasts.
        ranges: what of the simulation varies.
        frames: where the pictures go, of a task with a camera.
        by_state: the policy is of the task without a camera: it acts on the `full_obs` that the environment then has.
        least_success: share of the episodes that must succeed (else `DemosError`), where the task has that notion.
        stopped: asked after every episode with the steps so far and steps per second.
    """
    env = Observer(task, horizon, None if frames is None else frames.space, repeat, ranges)
    rng, began = Streams(seed).numpy("demonstrations"), time.monotonic()
    steps: dict[str, list[Any]] = {"obs": [], "act": [], "next_obs": [], "terminated": []}
    lengths: list[int] = []
    returns: list[float] = []
    successes: list[float] = []
    try:
        for _ in range(episodes):
            obs = env.reset(seed=int(rng.integers(2**31)))
            _film(frames, obs)
            begin, total, success, over = len(steps["obs"]), 0.0, -np.inf, False
            while not over:
                shown = Obs(env.env.full_obs) if by_state else obs  # type: ignore[attr-defined]
                act = np.clip(policy(shown), -1.0, 1.0).astype(np.float32)
                next_obs, reward, terminated, truncated, info = env.step(act)
                for values, value in zip(steps.values(), (obs.state, act, next_obs.state, terminated), strict=True):
                    values.append(value)
                _film(frames, next_obs)
                total += reward
                success = max(success, float(info["success"])) if "success" in info else np.nan
                obs, over = next_obs, terminated or truncated
            played = len(steps["obs"])
            lengths.append(played - begin)
            returns.append(total)
            successes.append(success)
            if stopped(played * repeat, played * repeat / (time.monotonic() - began)):
                return None
    finally:
        env.close()
    demos = Demonstrations(
        obs=np.array(steps["obs"], np.float32),
        act=np.array(steps["act"], np.float32),
        next_obs=np.array(steps["next_obs"], np.float32),
        terminated=np.array(steps["terminated"], np.uint8),
        lengths=np.array(lengths, np.int64),
        returns=np.array(returns, np.float64),
        successes=np.array(successes, np.float64),
        provenance={"task": task, "seed": seed, **source, **({} if repeat == 1 else {"action_repeat": repeat})},
        frames=frames,
    )
    if demos.success < least_success:
        raise DemosError(
            f"the expert succeeds in {demos.success:.0%} of {episodes} episodes of {task}, {least_success:.0%} are "
            "asked for: train it longer, ask for less with imitation.expert_success, or name a file of your own with "
            "imitation.demos"
        )
    return demos


def _film(frames: Frames | None, obs: Obs) -> None:
    """Keep the newest picture."""
    if frames is not None and obs.frames is not None:
        frames.append(obs.frames[-1])
