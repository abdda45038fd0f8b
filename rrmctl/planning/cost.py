"""What a plan will cost, in core-hours: from runs of the same kind where the store has some, else from a model.

A job takes 3 s to start. Measured, on top of that: `steps / (steps per second)`, the rate being the median over the
stored runs of the same task, method and variant.

Modelled, for P weights of a network, B transitions in a batch and G floating-point operations per second of this core
in matrix products (`measure_gemm`):

    update     0.5 ms + 1.2 * 2 B (4 P_actor + 12 P_critic) / G      forward and backward, twin critics and their target
    entropy    2 B O S / G more per unsupervised update               distances to the buffer's S states, O features
    step       simulator + 0.3 ms                                     acting and storing
    session    epochs * n / minibatch * (0.5 ms + 1.2 * 12 P_reward * segment * minibatch * members / G)
               + 1.2 * 2 P_reward * members * step / G                n labels so far; relabelling the buffer
               (SURF: segments with their margins, and its pairs without a label in each minibatch)
    imitation  updates / every * (0.5 ms + 1.2 * 4 B (3 P_g + 6 P_h + P_actor) / G)      discriminator, and for every
               + 0.5 ms + 1.2 * 2 B (P_g + 2 P_h) / G                                   step the reward of a batch
    evaluation episodes * steps of an episode * (simulator + 0.3 ms)

The constants were fitted on one machine; the result is good to about a factor of 1.5. One job keeps one core busy.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from rrm.environ import environment
from rrmctl.errors import UserError

if TYPE_CHECKING:
    from rrm.training.run_config import RunConfig
    from rrmctl.planning.plan import Plan
    from rrmctl.planning.prerequisites import Config

#: (task, method, variant) -> environment steps per second, evaluation included.
Rates = Mapping[tuple[str, str, str], float]

#: Seconds of one environment step, by task or else by suite.
_SIMULATOR_S = {
    "metaworld": 1 / 1800, "sweep-into": 1 / 800,
    "dmc": 1 / 3200, "walker-walk": 1 / 4900,
    "toy": 1 / 30_000,
}  # fmt: skip
_UNKNOWN_S = 1 / 1000  # of a simulator that nobody has measured
_START_S = 3.0  # loading torch and the simulator in a process of its own
_CALL_S = 0.0005  # an update's cost beside its products: launching operations, optimisers
_ACT_S = 0.0003
_SLACK = 1.2  # elementwise work beside the products

_PROBE = """
import time, numpy as np
a, b = np.ones((256, 256), np.float32), np.ones((256, 256), np.float32)
spent = []
while len(spent) < 20 or sum(spent) < 0.03:
    start = time.process_time()
    a @ b
    spent.append(time.process_time() - start)
print(2 * 256**3 / min(filter(None, spent)))
"""


@dataclass(frozen=True)
class CostEstimate:
    """Cost of every job of a plan on its own core."""

    seconds: Mapping[str, float]  #: by job id, from nothing to the end
    measured: frozenset[str]  #: ids of the jobs whose rate comes from stored runs

    def core_hours(self, left: Mapping[str, float] | None = None) -> float:
        """Of all jobs, or of so much of each as is `left`, in whole jobs (1 where it is not named)."""
        share = left or {}
        return sum(s * share.get(job, 1.0) for job, s in self.seconds.items()) / 3600

    @property
    def source(self) -> str:
        """Where the numbers come from, in words."""
        count, known = len(self.seconds), len(self.measured)
        if known == count:
            return "from the speed of stored runs"
        model = "from the measured speed of one core and a count of operations"
        return model if known == 0 else f"{known} of {count} jobs from the speed of stored runs, the rest {model}"


def estimate_cost(plan: Plan, rates: Rates, gemm: float | None = None) -> CostEstimate:
    """The cost of a plan.

    Args:
        rates: speeds of stored runs; see `rrmctl.store.speeds`.
        gemm: floating-point operations per second of one core; None measures it if it is needed.
    """
    seconds: dict[str, float] = {}
    measured = set()
    modelled: dict[tuple[str, ...], float] = {}
    for job in plan.everything:
        rate = rates.get((job.task, job.method, plan.variant))
        if rate is not None:
            seconds[job.id] = _START_S + job.steps / rate
            measured.add(job.id)
            continue
        if job.row not in modelled:  # seeds cost the same
            gemm = measure_gemm() if gemm is None else gemm
            modelled[job.row] = model_seconds(plan.configs[job.id], gemm)
        seconds[job.id] = modelled[job.row]
    return CostEstimate(seconds, frozenset(measured))


@cache
def measure_gemm() -> float:
    """Floating-point operations per second of one core in matrix products, measured for 30 ms in a process of its own.

    The best of at least twenty products counts, in the time that the core spent on it: what else runs on a busy machine
    does not. It is measured once; all estimates of a command go by the same speed.

    Raises:
        UserError: numpy does not work here.
    """
    one = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "VECLIB", "NUMEXPR")}
    done = subprocess.run(
        [sys.executable, "-c", _PROBE], env=environment() | one, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["?"])[-1]
        raise UserError(f"the speed of this machine cannot be measured: {last}", "`rrmctl doctor` says what is missing")
    return float(done.stdout)


def model_seconds(config: Config, gemm: float) -> float:
    """Seconds of one run from nothing to its end on one core; the formula is at the top of this module.

    Args:
        gemm: floating-point operations per second of the core.
    """
    spec = config.spec()
    step = _SIMULATOR_S.get(spec.name) or _SIMULATOR_S.get(spec.suite, _UNKNOWN_S) + _ACT_S
    if config.kind == "demos":
        return _START_S + config.steps * step
    agent = config.agent
    actor = _weights(spec.spaces.obs, agent.hidden, agent.layers, 2 * spec.spaces.act)
    critic = _weights(spec.spaces.obs + spec.spaces.act, agent.hidden, agent.layers, 1)
    update = _CALL_S + _SLACK * 2 * agent.batch * (4 * actor + 12 * critic) / gemm
    updates = max(config.steps - config.random_steps, 0) / agent.update_every
    states = config.random_steps + config.exploration.unsupervised_steps / 2
    entropy = config.exploration.unsupervised_steps * 2 * agent.batch * spec.spaces.obs * states / gemm
    evaluated = math.ceil(config.steps / config.evaluation.every) * config.evaluation.episodes * config.episode_steps
    learning = updates * update + entropy + _reward_seconds(config, gemm) + _imitation_seconds(config, gemm)
    return _START_S + (config.steps + evaluated) * step + learning


def _reward_seconds(config: RunConfig, gemm: float) -> float:
    """Every feedback session of the run."""
    sessions, feedback, reward = config.sessions(), config.feedback, config.reward
    if sessions == 0 or feedback is None:
        return 0.0
    spec = config.spec()
    inputs = spec.spaces.obs + spec.spaces.act + (reward.prior is not None)
    weights = _weights(inputs, reward.hidden, reward.layers, 1) * reward.members
    rows = (feedback.segment + 2 * reward.settings.needs().margin) * reward.minibatch * reward.settings.pairs_per_label
    fit = _CALL_S + _SLACK * 12 * weights * rows / gemm
    labels = min(feedback.batch * (sessions + 1) / 2, reward.capacity)  # the mean over the sessions
    stored = config.first_session + feedback.every * (sessions - 1) / 2
    relabel = _SLACK * 2 * weights * stored / gemm
    return sessions * (reward.epochs * max(labels / reward.minibatch, 1) * fit + relabel)


def _imitation_seconds(config: RunConfig, gemm: float) -> float:
    """What learning from demonstrations adds: the discriminator's steps, and a reward for every batch of the agent."""
    if not config.from_demonstrations:
        return 0.0
    spec, imitation, agent = config.spec(), config.imitation, config.agent
    steps = (config.first_session if config.reward.kind.learned else config.steps) - config.random_steps
    shape = (imitation.hidden, imitation.layers, 1)
    g, h = _weights(spec.spaces.obs + spec.spaces.act, *shape), 2 * _weights(spec.spaces.obs, *shape)
    actor = _weights(spec.spaces.obs, agent.hidden, agent.layers, 2 * spec.spaces.act)
    gradient = _CALL_S + _SLACK * 2 * (2 * imitation.minibatch) * (3 * g + 3 * h + actor) / gemm
    reward = _CALL_S + _SLACK * 2 * agent.batch * (g + h) / gemm
    return steps * (imitation.updates / imitation.every * gradient + reward / agent.update_every)


def _weights(inputs: int, hidden: int, layers: int, outputs: int) -> int:
    return inputs * hidden + (layers - 1) * hidden * hidden + hidden * outputs
