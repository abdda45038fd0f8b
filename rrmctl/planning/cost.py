"""What a plan will cost: by the speed of runs of the same kind in the store, else by the table costs.toml.

Matrix products scale with the size of the networks and with the measured speed of this core, or of the card that they
are on. The table is good to about a factor of two. One job keeps one core busy.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.config import AIRL, DrqConfig, EvaluationConfig, ExplorationConfig, RewardConfig
from rrm.devices import CUDA, cards
from rrm.training.kinds import DemosConfig, DeploymentConfig
from rrm.training.run_config import RunConfig
from rrmctl.planning import card_rates
from rrmctl.planning.toml import read_toml

if TYPE_CHECKING:
    from rrm.envs.spaces import FrameSpace
    from rrmctl.planning.plan import Plan
    from rrmctl.planning.prerequisites import Config


_COSTS = read_toml(Path(__file__).with_name("costs.toml"))


def estimate_seconds(plan: Plan, speeds: Mapping[tuple[str, str, str], float]) -> dict[str, float | None]:
    """What every job of a plan takes on a core of its own, and on its place of a card where it is on one, from nothing
    to the end, by id; None where nobody knows: what a card does, only measuring it tells.

    Stored runs have their speeds, evaluation included, in steps per second by task, method and variant.
    """
    seconds: dict[str, float | None] = {}
    tabled: dict[tuple[str, ...], float | None] = {}
    for job in plan.everything:
        stored = speeds.get((job.task, job.method, plan.variant))
        if stored is None and job.row not in tabled:  # seeds cost the same
            config = plan.configs[job.id]
            speed = card_speed() if on_card(config) else core_speed()
            tabled[job.row] = None if speed is None else tabled_seconds(config, speed)
        seconds[job.id] = tabled[job.row] if stored is None else _COSTS["start"] / 1000 + job.steps / stored
    return seconds


def on_card(config: Config) -> bool:
    """Whether networks learn on a graphics card."""
    return isinstance(config, RunConfig) and config.device == CUDA  # of a plan: canonical


def trial(device: str, seed: int) -> RunConfig:
    """The run by which a card is measured: networks and batches of the paper's size, and little else to do."""
    return RunConfig(
        task="toy-car", seed=seed, device=device, steps=1_000_000, reward=RewardConfig(learner="true"),
        evaluation=EvaluationConfig(every=1_000_000), exploration=ExplorationConfig(seed_steps=100),
    )  # fmt: skip


def card_speed() -> float | None:
    """How fast a card of this machine multiplies for each of so many runs as pay, 1 for the table's core; None where
    there is none, or nobody has measured it.
    """
    rates = card_rates.read(cards()[0]) if cards() else None
    if rates is None:
        return None
    config = trial(CUDA, 0)
    without, with_core = (tabled_seconds(config, speed) for speed in (math.inf, 1.0))
    took = config.steps / rates.each
    # A card may be quicker than what the table has for all that is no product: then products are as good as free.
    return (with_core - without) / max(took - without, 0.01 * took)


@cache
def core_speed() -> float:
    """How fast a core of this machine multiplies matrices, 1 for the table's; measured once, for 30 ms.

    The best of at least twenty products counts, in the time that the core spent on it: what else runs on a busy machine
    does not. They are so small that no library divides one between cores.
    """
    import numpy as np

    factor = np.ones((64, 64), np.float32)
    spent: list[float] = []
    while len(spent) < 20 or sum(spent) < 0.03:
        start = time.process_time()
        factor @ factor
        spent.append(time.process_time() - start)
    return float(2 * 64**3 / min(filter(None, spent)) / _COSTS["flops"])


def tabled_seconds(config: Config, speed: float) -> float:
    """Seconds of one run from nothing to its end, by the table, on a core of this `core_speed`."""
    spec = config.spec()
    step = _COSTS["step"].get(spec.name) or _COSTS["step"].get(spec.suite, _COSTS["step"]["unknown"])
    if isinstance(config, DeploymentConfig):
        pixels = config.rig.width * config.rig.height / (640 * 480)
        played = len(config.checkpoints) * config.episodes * config.policy.episode_steps
        return float(_COSTS["start"] + played * (step + _COSTS["deploy"]["moment"] * pixels)) / 1000
    if isinstance(config, DemosConfig):
        return float(_COSTS["start"] + config.steps * step) / 1000
    agent, reward, feedback = config.agent, config.reward, config.feedback
    learner = _COSTS["learner"].get(reward.learner, _COSTS["learner"]["default"])
    reference = 2 * 256**2
    update = learner["update"] * (agent.layers - 1) * agent.hidden**2 / reference * agent.batch / 512
    looks = 0.0
    if isinstance(agent, DrqConfig) and config.spaces.frames is not None:
        look = _COSTS["frames"]["look"] * _convolutions(agent, config.spaces.frames)
        update = look * agent.batch * _COSTS["frames"]["looks"][reward.learner == AIRL]
        looks = config.sessions() * config.steps / config.action_repeat / 2 * look  # at all there is, a session
    updates = agent.updates(config.random_steps // config.action_repeat, config.steps // config.action_repeat)
    evaluated = math.ceil(config.steps / config.evaluation.every) * config.evaluation.episodes * config.episode_steps
    label = labels = 0.0
    if feedback is not None and (sessions := config.sessions()):
        label = learner["label"] * (reward.layers - 1) * reward.hidden**2 / reference * feedback.segment / 50
        may_end = reward.target_accuracy < 1 and "target_accuracy" not in reward.settings.ignores
        passes = min(reward.epochs, _COSTS["passes"]) if may_end else reward.epochs
        labels = sessions * passes * min(feedback.batch * (sessions + 1) / 2, reward.capacity)
    products = (updates * update + labels * label + looks) / speed
    return float(_COSTS["start"] + (config.steps + evaluated) * step + updates * learner["call"] + products) / 1000


def _convolutions(agent: DrqConfig, frames: FrameSpace) -> float:
    """Million multiplications of an encoder for one look."""
    total, seen, (height, width) = 0, frames.stack * frames.channels, (frames.height, frames.width)
    for stride in agent.strides:
        height, width = ((side - 3) // stride + 1 for side in (height, width))
        total, seen = total + 9 * seen * agent.channels * height * width, agent.channels
    return total / 1e6
