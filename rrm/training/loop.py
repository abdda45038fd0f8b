"""The training loop. It drives any agent through any phases: what differs between methods lies behind their seams.

One step, in B-Pref's order: choose an action; learn (feedback when it is due, then an update); step the environment;
store the transition with its prior value. The update at step t therefore never sees transition t. Steps are counted
that the environment takes; an action lasts `action_repeat` of them.
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rrm.envs.observer import Observer
from rrm.errors import NumericalError, WaitingError
from rrm.nets.captured import prepare
from rrm.nets.precision import check_precision
from rrm.seeding import Streams, evaluation_seed
from rrm.sources.base import RewardSource
from rrm.training.build import NO_RESULTS, Assembled, Results, assemble
from rrm.training.episodes import evaluate
from rrm.training.run_config import RunConfig
from rrm.types import EvalRow, Obs, State, Transition

_NAN = float("nan")


class Trainer:
    """All the state of one run. `advance` takes one environment step; rows are asked for with `evaluate`."""

    def __init__(self, config: RunConfig, results: Results = NO_RESULTS, assembled: Assembled = assemble) -> None:
        """Args: assembled: makes agent, prior and phases."""
        prepare(config.device, config.precision)
        check_precision(config.precision, config.device)
        self.config = config
        self.step = 0
        self.rows: list[EvalRow] = []  #: evaluations so far, oldest first
        self.streams = Streams(config.seed)
        self.env, self._eval_env = (
            Observer(config.task, config.horizon, config.spaces.frames, config.action_repeat, config.env.ranges())
            for _ in range(2)
        )
        parts = assembled(config, self.streams, results)
        self.agent = parts.agent
        self.experience = parts.experience
        self.prior = parts.prior
        self.phases = parts.phases
        self.people = parts.people
        self.sources: dict[str, RewardSource] = {phase.source.name: phase.source for phase in self.phases}
        self._started = time.monotonic()  # as if nothing had interrupted it
        self._row_wall_s, self._row_step = 0.0, 0  # at the last row
        self._explore = self.streams.numpy("explore")
        self._row_transition = 0  # transitions at the last row
        self._return, self._length = 0.0, 0  # of the episode under way
        self._obs = self._reset(seed=int(self.streams.numpy("env").integers(2**31)))

    def advance(self) -> None:
        """One action, of one environment step or several, with all the learning that belongs to it.

        A `WaitingError` says what the reward needs that is not there yet; nothing of the step has happened.
        """
        phase = next(phase for phase in reversed(self.phases) if phase.begin <= self.step)
        self.agent.at(self.step)
        phase.source.ask(self.step)
        missing = phase.source.waiting()
        if missing:
            raise WaitingError(missing)
        if phase.random:
            act = self._explore.uniform(-1.0, 1.0, self.config.spaces.act).astype(np.float32)
        else:
            act = self.agent.act(self._obs, explore=True)
        phase.source.attend(self.step, self.agent)
        if self.step == phase.begin and phase.reset_critic:
            self.agent.reset_critic()
        due = 0 if phase.random else self.config.agent.updates_at(self.step // self.config.action_repeat)
        for _ in range(phase.first_updates if self.step == phase.begin else due):
            self.agent.update(phase.source.batch(self.agent))
        next_obs, true_reward, terminated, truncated, info = self.env.step(act)
        if not np.isfinite(true_reward):
            raise NumericalError(f"step {self.step}: the true reward is {true_reward}")
        obs, self._obs = self._obs, next_obs
        raw, prior = (0.0, 0.0) if self.prior is None else self.prior(obs, act, info, self.step)
        step = Transition(
            obs.state, act, next_obs.state, prior, raw, true_reward, terminated, truncated, obs.frames, next_obs.frames
        )
        reward = phase.source.reward(step)
        if not np.isfinite(reward):
            raise NumericalError(f"step {self.step}: the reward is {reward}; the prior says {step.prior}")
        self.experience.append(step, reward)
        self._return += step.true_reward
        self._length += 1
        if step.terminated or step.truncated:
            for source in self.sources.values():
                source.episode_over(self._return, self._length)
            self._return, self._length = 0.0, 0
            self._obs = self._reset()
        self.step += self.config.action_repeat

    def _reset(self, seed: int | None = None) -> Obs:
        obs = self.env.reset(seed=seed)
        if self.people is not None:
            self.people.begins(self.env.env.state_dict())
        if self.prior is not None:
            self.prior.begin_episode(obs.state)
        return obs

    def evaluate(self) -> EvalRow:
        """Evaluate the policy as it is and summarise the transitions since the last row. Training does not notice."""
        config, step, sources = self.config, self.step, self.sources.values()
        result = evaluate(self.agent, self._eval_env, config.evaluation, seed=config.seed, step=step)
        rng = np.random.default_rng(evaluation_seed(config.seed, step, config.evaluation.episodes))
        figures = dict(self.agent.figures())
        for source in sources:
            source.evaluated(step, result)
            figures |= source.figures(rng)
        wall = time.monotonic() - self._started
        elapsed = wall - self._row_wall_s
        row = EvalRow(
            step=step, episodes=config.evaluation.episodes, true_return=result.true_return, success=result.success,
            queries=sum(source.queries for source in sources), labels=sum(source.labels for source in sources),
            **self._lived(), wall_s=wall, steps_per_s=(step - self._row_step) / elapsed if elapsed else _NAN,
            figures=figures,
        )  # fmt: skip
        self._row_wall_s, self._row_step = wall, step
        self._row_transition = self.experience.transitions
        self.rows.append(row)
        return row

    def _lived(self) -> dict[str, Any]:
        rows = self.experience.since(self._row_transition)
        reward, prior = self.experience.reward[rows].double(), self.experience.prior[rows].double()
        has_prior = self.prior is not None
        return {
            "prior_mean": float(prior.mean()) if has_prior else _NAN,
            "residual_mean": float((reward - prior).mean()) if has_prior else _NAN,
            "reward_mean": float(reward.mean()),
            "reward_std": float(reward.std(correction=0)),
            "true_reward_mean": float(self.experience.true_reward[rows].double().mean()),
        }

    def save(self, folder: Path) -> State:
        """The state of the run; what only grows is appended to the logs in `folder`."""
        return {
            "experience": self.experience.save(folder),
            "env": self.env.state_dict(),
            "agent": self.agent.state_dict(),
            "prior": None if self.prior is None else self.prior.state_dict(),
            "sources": {name: source.state_dict() for name, source in self.sources.items()},
            "clock": {
                "wall_s": time.monotonic() - self._started, "row_wall_s": self._row_wall_s, "row_step": self._row_step,
            },
            "rows": [asdict(row) for row in self.rows],
            "loop": {
                "step": self.step, "obs": self._obs.state, "row_transition": self._row_transition,
                "return": self._return, "length": self._length,
            },
            "streams": self.streams.state_dict(),
        }  # fmt: skip

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on a fresh trainer of the same configuration."""
        self.experience.load(folder, state["experience"])
        self.env.load_state_dict(state["env"])
        self.agent.load_state_dict(state["agent"])
        if self.prior is not None:
            self.prior.load_state_dict(state["prior"])
        for name, source in self.sources.items():
            source.load_state_dict(state["sources"][name])
        self.rows = [EvalRow(**row) for row in state["rows"]]
        clock, loop = state["clock"], state["loop"]
        self._started = time.monotonic() - float(clock["wall_s"])
        self._row_wall_s, self._row_step = float(clock["row_wall_s"]), int(clock["row_step"])
        self.step, self._row_transition = int(loop["step"]), int(loop["row_transition"])
        self._obs = self.env.seen(loop["obs"])
        self._return, self._length = float(loop["return"]), int(loop["length"])
        self.streams.load_state_dict(state["streams"])

    def publish(self, folder: Path) -> None:
        """Replace what is to be looked at beside the curve, and put before people what they are to answer."""
        for source in self.sources.values():
            source.publish(folder)
        if self.people is not None:
            self.people.publish()

    def weights(self) -> State:
        """What training changes step by step, and what must stay finite."""
        weights = self.agent.weights()
        for source in self.sources.values():
            weights |= source.weights()
        return weights

    def legacy(self) -> State:
        """What a finished run leaves behind: the agent and, where there are such, the reward and the prior's scale."""
        left: State = {"agent": self.agent.state_dict()}
        if self.prior is not None:
            left["prior"] = self.prior.state_dict()
        for source in self.sources.values():
            left |= source.legacy()
        return left

    def close(self) -> None:
        """Free the simulators."""
        self.env.close()
        self._eval_env.close()
