"""What a notebook needs: train one run, take up a finished one, and use its policy and its reward elsewhere."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from rrm.checkpoint import read_networks
from rrm.config import DrqConfig, EvaluationConfig
from rrm.devices import CPU
from rrm.envs.base import TaskEnv
from rrm.envs.observer import Observer
from rrm.errors import ConfigError
from rrm.files import make_folder, place, read_bounded, write_atomically
from rrm.interfaces import Agent, FrameEncoder, RewardFunction
from rrm.nets.encoder import Encoder
from rrm.priors.values import PriorSource
from rrm.seeding import Streams
from rrm.training.build import build_agent, build_prior, build_reward
from rrm.training.episodes import evaluate
from rrm.training.jobs import Monitor
from rrm.training.jobs import train as train_job
from rrm.training.run_config import RunConfig
from rrm.types import EvalRow, Evaluation, Floats, Obs, Pixels, State

_LARGEST_CONFIG = 1_000_000  # bytes


def train(
    config: RunConfig,
    folder: str | Path,
    *,
    results: Mapping[str, str | Path] | None = None,
    on_row: Callable[[EvalRow], None] = lambda _row: None,
) -> list[EvalRow]:
    """Train a run to its end, or go on with one that was interrupted: it ends with the same numbers.

    Returns the evaluations, oldest first.

    Args:
        config: of the run.
        folder: where checkpoints and, in the end, networks are kept; made where it is missing, of this run alone.
        results: folders of the runs that this one starts from, by identity (`config.requires`).
        on_row: told of every evaluation as it comes. Ctrl-C loses what was trained since the last checkpoint.

    Raises:
        ConfigError: the folder is another run's.
        RrmError: the run cannot be trained as it is described.
        WaitingError: it waits for its teacher; called again, it goes on.
    """
    run, where = config.canonical(), place(folder)
    make_folder(where)
    kept = where / "config.json"
    if kept.exists() and _read(kept).identity != run.identity:
        raise ConfigError(f"{where} holds another run, {_read(kept).identity}: name another folder")
    write_atomically(kept, run.model_dump_json(indent=1).encode())
    if (where / "model.safetensors").exists():
        return [_row(row) for row in json.loads((where / "rows.json").read_bytes())]
    monitor = _Listener(on_row)
    train_job(run, where, monitor, {name: place(path) for name, path in (results or {}).items()})
    rows = [monitor.rows[step] for step in sorted(monitor.rows)]
    write_atomically(where / "rows.json", json.dumps([row.columns() for row in rows]).encode())
    return rows


def load(folder: str | Path) -> Finished:
    """A finished run: one of `train`, or a folder `runs/ID` of `rrmctl`.

    Raises:
        ConfigError: the folder holds no run.
        MissingResultError: the run is not finished, or its networks are damaged.
    """
    where = place(folder)
    return Finished(_read(where / "config.json"), where)


class Finished:
    """What a finished run has learned; the runs that it started from lie beside its folder."""

    def __init__(self, config: RunConfig, folder: Path) -> None:
        self.config = config
        self._folder = folder
        self._networks: State = read_networks(folder / "model.safetensors", "the run's networks")

    @property
    def _here(self) -> RunConfig:
        """On the processor, wherever it has learned."""
        return self.config.model_copy(update={"device": CPU})

    @cached_property
    def agent(self) -> Agent:
        """The agent as it was at the end."""
        agent = build_agent(self._here, Streams(self.config.seed))
        agent.load_state_dict(self._networks["agent"])
        return agent

    def policy(self, obs: Floats | Pixels) -> Floats:
        """The deterministic action, float32 [A] in [-1, 1], for an observation float32 [O], or for what an agent that
        sees frames is shown, uint8 [stack, channels, height, width].
        """
        if self.config.sees_frames:
            return self.agent.act(Obs(np.zeros(0, np.float32), np.asarray(obs, np.uint8)), explore=False)
        return self.agent.act(Obs(np.asarray(obs, np.float32)), explore=False)

    def evaluate(self, episodes: int = 10, seed: int = 0) -> Evaluation:
        """Play episodes of the run's task, whose instances follow from the seed; success counts as in the run."""
        config = self.config
        counted = EvaluationConfig(episodes=episodes, success=config.evaluation.success)
        env = Observer(config.task, config.horizon, config.spaces.frames, config.action_repeat, config.env.ranges())
        try:
            return evaluate(self.agent, env, counted, seed=seed, step=0)
        finally:
            env.close()

    @cached_property
    def reward(self) -> RewardFunction:
        """The learned reward; a `ConfigError` where the run learned none."""
        if not self.config.reward.kind.learned:
            raise ConfigError(f"{self._folder} holds no learned reward: the method is {self.config.method}")
        reward = build_reward(self._here, Streams(self.config.seed))
        reward.load_state_dict(self._networks["reward"])
        return reward

    @cached_property
    def encoder(self) -> FrameEncoder | None:
        """What makes the features of frames that the learned reward sees; None where it is shown states."""
        agent, frames = self.config.agent, self.config.spaces.frames
        if not isinstance(agent, DrqConfig) or frames is None:
            return None
        encoder = Encoder(agent, frames, None, self.config.precision)
        encoder.flat.copy_(self._networks["sight"]["encoder"])
        return encoder

    @cached_property
    def prior(self) -> PriorSource | None:
        """The prior under the learned reward, at the scale it had at the end; None where there is none."""
        results = {run: self._folder.parent / run for run in self.config.requires}
        prior = build_prior(self.config, Streams(self.config.seed), results)
        if prior is not None:
            prior.load_state_dict(self._networks["prior"])
        return prior


class LearnedReward(gymnasium.Wrapper[Any, Floats, Floats, Floats]):
    """An environment of the run's task that pays what the run has learned, for anybody's training loop.

    It shows what the run's agent saw: the state [O], or the newest frames, uint8 [stack, channels, height, width]; an
    action lasts as many steps. `info["true_reward"]` is the environment's own.
    """

    def __init__(self, env: TaskEnv, run: Finished) -> None:
        super().__init__(env)
        space = run.config.spaces.frames
        if space is not None:
            self.observation_space = gymnasium.spaces.Box(0, 255, (space.stack, *space.planar), np.uint8)
        self._reward, self._prior, self._encoder = run.reward, run.prior, run.encoder
        self._observer = Observer(env, frames=space, repeat=run.config.action_repeat)
        self._obs = Obs(np.zeros(0, np.float32))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:  # noqa: ARG002 (gymnasium's)
        """Start an episode."""
        self._obs = self._observer.reset(seed)
        if self._prior is not None:
            self._prior.begin_episode(self._obs.state)
        return _shown(self._obs), {}

    def step(self, action: Floats) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One action, with the learned reward of the state before it."""
        act, before = np.asarray(action, np.float32), self._obs
        self._obs, true_reward, terminated, truncated, info = self._observer.step(act)
        prior = 0.0 if self._prior is None else self._prior.look(before, act, info)
        seen = torch.from_numpy(_shown(before))[None]
        seen = seen if self._encoder is None else self._encoder.encode(seen)
        reward = float(self._reward.predict(seen, torch.from_numpy(act)[None], torch.tensor([prior])))
        return _shown(self._obs), reward, terminated, truncated, info | {"true_reward": float(true_reward)}


def _shown(obs: Obs) -> Any:
    return obs.state if obs.frames is None else obs.frames


class _Listener(Monitor):
    """A monitor that keeps the evaluations."""

    def __init__(self, on_row: Callable[[EvalRow], None]) -> None:
        self._on_row = on_row
        self.rows: dict[int, EvalRow] = {}

    def restored(self, rows: Sequence[EvalRow]) -> None:
        self.rows |= {row.step: row for row in rows}

    def row(self, row: EvalRow) -> None:
        self.rows[row.step] = row
        self._on_row(row)

    def beat(self, step: int, steps_per_s: float) -> None: ...

    def note(self, message: str) -> None: ...


def _read(path: Path) -> RunConfig:
    try:
        stored = json.loads(read_bounded(path, _LARGEST_CONFIG))
        return RunConfig.model_validate({name: stored[name] for name in RunConfig.model_fields if name in stored})
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise ConfigError(f"{path} is not the configuration of a run: {error}") from error


def _row(columns: Mapping[str, Any]) -> EvalRow:
    own = {name: columns[name] for name in EvalRow.__dataclass_fields__ if name != "figures"}
    return EvalRow(**own, figures={name: value for name, value in columns.items() if name not in own})
