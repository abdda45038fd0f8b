"""The seams of the library on one page.

Whatever has state offers `state_dict` and `load_state_dict`, with a `State` (see `rrm.types`) between them, and
continues bit for bit where it was saved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Sequence

    import gymnasium
    from torch import Tensor

    from rrm.types import Batch, Segments, State

Floats = npt.NDArray[np.float32]


class Stateful(Protocol):
    """Something a checkpoint holds."""

    def state_dict(self) -> State:
        """Everything needed to continue exactly."""

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken."""


class Env(Protocol):
    """A gymnasium environment whose simulator can be saved in mid-episode.

    Observations are float32 [O] with every feature of its `Task`; actions lie in [-1, 1]; `reward` is the true reward;
    `info["success"]` is 0.0 or 1.0 for this step on tasks that have the notion. A time limit is `truncated`.
    """

    observation_space: gymnasium.spaces.Box[np.float32]
    action_space: gymnasium.spaces.Box[np.float32]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode; a seed restarts the stream from which task instances are drawn."""

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One environment step: observation, true reward, terminated, truncated, info."""

    def state_dict(self) -> State:
        """Simulator, task instance, step counter and random stream, at any moment between two steps."""

    def load_state_dict(self, state: State) -> None:
        """Continue from `state_dict`, bit for bit, in any process of the same machine type."""

    def close(self) -> None:
        """Free the simulator."""


class Agent(Stateful, Protocol):
    """An off-policy agent. It receives batches and knows neither environment nor buffer."""

    updates: int  #: finished so far

    def act(self, obs: Floats, *, explore: bool) -> Floats:
        """Action float32 [A] for one observation float32 [O]: a sample when exploring, else the deterministic one."""

    def update(self, batch: Batch) -> None:
        """One round of gradient steps (critic, actor, temperature, targets when due)."""

    def reset_critic(self) -> None:
        """Fresh critic, target and critic optimiser; actor and temperature stay (PEBBLE's first session)."""

    def q_values(self, obs: Tensor, act: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """What the critics say, float32 [2, B], differentiable; `params` stand in for their own."""

    def metrics(self) -> dict[str, float]:
        """Figures of the last update: `critic_loss`, `actor_loss`, `entropy`, `alpha`; NaN before the first."""


class StochasticAgent(Agent, Protocol):
    """An agent whose policy has a density."""

    def log_prob(self, obs: Tensor, act: Tensor) -> Tensor:
        """Log density of any actions [B, A] at obs [B, O], without gradient: float32 [B], nats, finite."""


class RewardFunction(Stateful, Protocol):
    """A learned reward: what an ensemble says of each step, with or without a prior inside."""

    def members(self, segments: Segments) -> Tensor:
        """Reward of every step by every member, float32 [N, B, T], differentiable."""

    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:
        """Mean over the members, float32 [B], without gradient."""

    def parameters(self) -> list[Tensor]:
        """What an optimiser steps."""


class RewardLearner(Stateful, Protocol):
    """Trains a reward function from preferences; PEBBLE, SURF and MRN differ only behind this seam."""

    reward: RewardFunction

    def fit(self, feedback: Feedback) -> dict[str, float]:
        """One feedback session's worth of training on every label so far; `label_accuracy` and the like."""

    def refine(self, batch: Batch, agent: Agent) -> bool:
        """Called before every agent update, for learners that need the critic; True when the reward changed."""


class Feedback(Protocol):
    """What a session hands the learner: every labelled pair so far."""

    def __len__(self) -> int:
        """Labelled pairs."""

    def pairs(self, index: Tensor) -> tuple[Segments, Segments, Tensor]:
        """Pairs by position: both segments, and the probability float32 [B] that the second is preferred."""


class Teacher(Stateful, Protocol):
    """Answers queries. The scripted one reads true rewards; a person sees the segments."""

    def label(self, true_rewards: tuple[Floats, Floats]) -> npt.NDArray[np.int8]:
        """For each pair of segments (true reward per step, [B, T] each): 0 first, 1 second, -1 equal, -2 skipped."""

    def observe_return(self, true_return: float, length: int) -> None:
        """Told of each finished training episode, for thresholds that follow the agent's level."""
