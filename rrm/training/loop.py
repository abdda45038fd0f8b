"""The training loop. It drives any learner: oracle, PEBBLE, residual models and those to come differ behind their
seams.

One step, in B-Pref's order: choose an action; learn (feedback when it is due, then an update); step the environment;
store the transition with its prior value. The update at step t therefore never sees transition t.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from rrm.agents.sac import Sac
from rrm.buffers.experience import Experience
from rrm.envs import make
from rrm.errors import NumericalError
from rrm.interfaces import Floats
from rrm.nets.precision import check_precision
from rrm.seeding import Streams, evaluation_seed
from rrm.training.build import Results, build_imitation, build_prior, build_sessions
from rrm.training.config import RunConfig
from rrm.training.evaluate import evaluate
from rrm.training.intrinsic import StateEntropy
from rrm.types import EvalRow, State

_NAN = float("nan")


@dataclass
class Clock:
    """Training time without interruptions, and the step rate since the last row."""

    wall_s: float = 0.0  #: up to `started`
    row_wall_s: float = 0.0  #: at the last row
    row_step: int = 0
    started: float = field(default_factory=time.monotonic)

    def now(self) -> float:
        """Seconds of training so far."""
        return self.wall_s + time.monotonic() - self.started

    def state_dict(self) -> State:
        return {"wall_s": self.now(), "row_wall_s": self.row_wall_s, "row_step": self.row_step}

    def load_state_dict(self, state: State) -> None:
        self.wall_s, self.row_wall_s = float(state["wall_s"]), float(state["row_wall_s"])
        self.row_step = int(state["row_step"])
        self.started = time.monotonic()


class Trainer:
    """All the state of one run. `advance` takes one environment step; rows are asked for with `evaluate`."""

    def __init__(self, config: RunConfig, results: Results = MappingProxyType({})) -> None:
        """Args: results: folders of the runs that this one requires, by identity."""
        check_precision(config.precision)
        spec = config.spec()
        self.config = config
        self.step = 0
        self.rows: list[EvalRow] = []  #: evaluations so far, oldest first
        self.streams = Streams(config.seed)
        self.env = make(config.task, horizon=config.horizon)
        self._eval_env = make(config.task, horizon=config.horizon)
        self.agent = Sac(config.agent, spec.obs_dim, spec.act_dim, self.streams, precision=config.precision)
        self.experience = Experience(config.steps, spec.obs_dim, spec.act_dim)
        self.prior = build_prior(config, self.streams, results)
        self.imitation = build_imitation(config, self.experience, self.streams, results)
        self.sessions = build_sessions(config, self.experience, self.streams, self.imitation)
        self.entropy = StateEntropy(config.exploration.neighbours)
        self.clock = Clock()
        self._replay = self.streams.torch("replay")
        self._explore = self.streams.numpy("explore")
        self._row_transition = 0  # transitions at the last row
        self._return, self._length = 0.0, 0  # of the episode under way
        self._obs = self._reset(seed=int(self.streams.numpy("env").integers(2**31)))

    def advance(self) -> None:
        """One environment step with all the learning that belongs to it.

        Raises:
            NumericalError: an action, reward or prior is not finite.
            PriorError: the prior failed.
        """
        act = self._act()
        self._learn()
        next_obs, true_reward, terminated, truncated, info = self.env.step(act)
        if not np.isfinite(true_reward):
            raise NumericalError(f"step {self.step}: the true reward is {true_reward}")
        raw, prior = (0.0, 0.0) if self.prior is None else self.prior(self._obs, act, info, self.step)
        if self.imitation is not None and self.imitation.leads:
            reward = self.imitation.look(self._obs, act, next_obs, terminated=terminated)
        else:
            reward = self._reward(self._obs, act, prior, true_reward)
        if not np.isfinite(reward):
            raise NumericalError(f"step {self.step}: the reward is {reward}; the prior says {prior}")
        self.experience.append(
            obs=self._obs, act=act, prior=prior, raw_prior=raw, true_reward=true_reward,
            reward=reward, next_obs=next_obs, terminated=terminated, truncated=truncated,
        )  # fmt: skip
        self._return += true_reward
        self._length += 1
        self._obs = self._finish_episode() if terminated or truncated else next_obs
        self.step += 1

    def _act(self) -> Floats:
        if self.step < self.config.random_steps:
            return self._explore.uniform(-1.0, 1.0, self.config.spec().act_dim).astype(np.float32)
        return self.agent.act(self._obs, explore=True)

    def _learn(self) -> None:
        config, sessions, imitation = self.config, self.sessions, self.imitation
        if imitation is not None and imitation.leads:
            imitation.train(self.agent)
        if sessions is None or (imitation is not None and imitation.leads):
            if self.step > config.random_steps:
                self._update()
        elif self.step == config.first_session and imitation is None:
            sessions.hold(self.step)
            self.agent.reset_critic()
            for _ in range(config.exploration.reset_updates):
                self._update(always=True)
        elif self.step >= config.first_session:
            if sessions.due(self.step):
                sessions.hold(self.step)
            self._update()
        elif self.step > config.random_steps:
            self._update_on_entropy()

    def _update(self, *, always: bool = False) -> None:
        agent = self.config.agent
        if not always and self.step % agent.update_every:
            return
        sessions = self.sessions
        if self.imitation is not None and self.imitation.leads:
            batch = self.experience.sample(agent.batch, self._replay)
            batch = batch._replace(reward=self.imitation.reward(batch))
        elif sessions is not None and sessions.refinement_due(self.step):
            limits_end = sessions.learner.needs.time_limits_end
            batch = sessions.refine(
                self.experience.sample(agent.batch, self._replay, time_limits_end=limits_end), self.agent
            )
        else:
            batch = self.experience.sample(agent.batch, self._replay)
        self.agent.update(batch)

    def _update_on_entropy(self) -> None:
        agent = self.config.agent
        if self.step % agent.update_every:
            return
        batch = self.experience.sample(agent.batch, self._replay)
        distance = self.experience.neighbour_distance(batch.obs, self.config.exploration.neighbours)
        self.agent.update(batch._replace(reward=self.entropy(distance)))

    def _reward(self, obs: Floats, act: Floats, prior: float, true_reward: float) -> float:
        if self.sessions is None:
            return true_reward if self.config.reward.learner == "true" else prior
        step = (torch.from_numpy(obs)[None], torch.from_numpy(act)[None], torch.tensor([prior]))
        return float(self.sessions.learner.reward.predict(*step))

    def _finish_episode(self) -> Floats:
        if self.sessions is not None:
            self.sessions.teacher.observe_return(self._return, self._length)
        self._return, self._length = 0.0, 0
        return self._reset()

    def _reset(self, seed: int | None = None) -> Floats:
        obs, _ = self.env.reset(seed=seed)
        if self.prior is not None:
            self.prior.begin_episode(obs)
        return obs

    def evaluate(self) -> EvalRow:
        """Evaluate the policy as it is and summarise the transitions since the last row. Training does not notice.

        Raises:
            NumericalError: a loss is not finite.
        """
        config = self.config
        result = evaluate(self.agent, self._eval_env, config.evaluation, seed=config.seed, step=self.step)
        if self.imitation is not None:
            self.imitation.evaluated(result)
        figures: dict[str, Any] = self.agent.metrics()
        if self.agent.updates and not np.isfinite(list(figures.values())).all():
            raise NumericalError(f"step {self.step}: a figure of the agent is not finite: {figures}")
        wall = self.clock.now()
        elapsed = wall - self.clock.row_wall_s
        row = EvalRow(
            step=self.step, episodes=config.evaluation.episodes, true_return=result.true_return, success=result.success,
            **self._feedback_figures(), **self._lived_figures(), **figures, wall_s=wall,
            steps_per_s=(self.step - self.clock.row_step) / elapsed if elapsed else _NAN,
        )  # fmt: skip
        self.clock.row_wall_s, self.clock.row_step = wall, self.step
        self._row_transition = self.experience.transitions
        self.rows.append(row)
        return row

    def _feedback_figures(self) -> dict[str, Any]:
        sessions = self.sessions
        if sessions is None:
            return {"queries": 0, "labels": 0, "label_accuracy": _NAN, "true_accuracy": _NAN}
        rng = np.random.default_rng(evaluation_seed(self.config.seed, self.step, self.config.evaluation.episodes))
        return {
            "queries": sessions.requested, "labels": sessions.labelled,
            "label_accuracy": sessions.label_accuracy, "true_accuracy": sessions.true_accuracy(rng),
        }  # fmt: skip

    def _lived_figures(self) -> dict[str, Any]:
        rows = self.experience.since(self._row_transition)
        reward, prior = self.experience.reward[rows].double(), self.experience.prior[rows].double()
        known = self.prior is not None
        return {
            "prior_mean": float(prior.mean()) if known else _NAN,
            "residual_mean": float((reward - prior).mean()) if known else _NAN,
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
            "sessions": None if self.sessions is None else self.sessions.state_dict(),
            "prior": None if self.prior is None else self.prior.state_dict(),
            "imitation": None if self.imitation is None else self.imitation.state_dict(),
            "entropy": self.entropy.state_dict(),
            "clock": self.clock.state_dict(),
            "rows": [asdict(row) for row in self.rows],
            "loop": {
                "step": self.step, "obs": self._obs, "row_transition": self._row_transition,
                "return": self._return, "length": self._length,
            },
            "streams": self.streams.state_dict(),
        }  # fmt: skip

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on a fresh trainer of the same configuration.

        Raises:
            CheckpointError: the logs in `folder` do not hold what the state says.
        """
        self.experience.load(folder, state["experience"])
        self.env.load_state_dict(state["env"])
        self.agent.load_state_dict(state["agent"])
        if self.sessions is not None:
            self.sessions.load_state_dict(state["sessions"])
        if self.prior is not None:
            self.prior.load_state_dict(state["prior"])
        if self.imitation is not None:
            self.imitation.load_state_dict(state["imitation"])
        self.entropy.load_state_dict(state["entropy"])
        self.clock.load_state_dict(state["clock"])
        self.rows = [EvalRow(**row) for row in state["rows"]]
        loop = state["loop"]
        self.step, self._obs, self._row_transition = int(loop["step"]), loop["obs"], int(loop["row_transition"])
        self._return, self._length = float(loop["return"]), int(loop["length"])
        self.streams.load_state_dict(state["streams"])

    def weights(self) -> State:
        """What training changes step by step, and what must stay finite."""
        reward = None if self.sessions is None else self.sessions.learner.reward.state_dict()
        return {"actor": self.agent.actor.flat, "critic": self.agent.critic.flat, "reward": reward}

    def networks(self) -> State:
        """What a finished run leaves behind: the agent and, where there is one, the learned reward or the prior."""
        return {
            "agent": self.agent.state_dict(),
            "reward": None if self.sessions is None else self.sessions.learner.reward.state_dict(),
            "imitation": None if self.imitation is None else self.imitation.prior(),
        }

    def close(self) -> None:
        """Free the simulators."""
        self.env.close()
        self._eval_env.close()
