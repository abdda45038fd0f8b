"""The seams of the library on one page.

Whatever has state offers `state_dict` and `load_state_dict`, with a `State` (see `rrm.types`) between them, and
continues bit for bit where it was saved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from rrm.config import Needs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from rrm.types import Batch, Floats, Obs, Segments, State

__all__ = [
    "Agent", "Answer", "CriticAgent", "Feedback", "FrameEncoder", "Needs", "Query", "RewardFunction", "RewardLearner",
    "SegmentRef", "Stateful", "StochasticAgent", "Teacher", "VisualAgent",
]  # fmt: skip


class Stateful(Protocol):
    """Something a checkpoint holds."""

    def state_dict(self) -> State:
        """Everything needed to continue exactly."""

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken."""


class Agent(Stateful, Protocol):
    """An off-policy agent, made as `AGENTS[...](config, spaces, streams, precision=...)`, with `device=...` where it is
    to learn elsewhere than on the processor.

    It receives batches and knows neither environment nor buffer.
    """

    updates: int  #: finished so far

    def at(self, step: int) -> None:
        """Told of the environment's step that comes next, before it acts there or learns."""

    def act(self, obs: Obs, *, explore: bool) -> Floats:
        """Action float32 [A] for one observation: a sample when exploring, else the deterministic one."""

    def update(self, batch: Batch) -> None:
        """One round of gradient steps (critic, actor, temperature, targets when due)."""

    def reset_critic(self) -> None:
        """Fresh critic, target and critic optimiser; actor and temperature stay (PEBBLE's first session)."""

    def figures(self) -> Mapping[str, float]:
        """What the last update has to say, for the curve; NaN before the first. `NumericalError` if not finite."""

    def weights(self) -> State:
        """Tensors that training changes, and that must stay finite."""


class CriticAgent(Agent, Protocol):
    """An agent whose critics a learner may ask."""

    critic_lr: float  #: step size of the critics' optimiser

    def q_values(self, obs: Tensor, act: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """What the critics say, float32 [2, B], differentiable; `params` stand in for their own."""

    def critic_parameters(self) -> list[Tensor]:
        """The critics' own: leaves of autograd, in the order `q_values` takes them."""

    def q_target(self, batch: Batch) -> Tensor:
        """What the critics are regressed on, [B]: reward plus discounted soft value, differentiable in the reward.

        Its random draws are its own: whoever asks does not disturb training.
        """


class StochasticAgent(Agent, Protocol):
    """An agent whose policy has a density."""

    def log_prob(self, obs: Tensor, act: Tensor) -> Tensor:
        """Log density of any actions [B, A] at obs [B, O], without gradient: float32 [B], nats, finite."""


class FrameEncoder(Protocol):
    """What makes features of frames."""

    flat: Tensor  #: its parameters
    outputs: int  #: features, R

    def encode(self, frames: Tensor) -> Tensor:
        """Float32 [B, R] of uint8 [B, stack, channels, height, width], without gradient."""

    def frozen(self) -> FrameEncoder:
        """A copy that does not change any more."""


class VisualAgent(Agent, Protocol):
    """An agent that sees frames, by an encoder that a learned reward may borrow."""

    @property
    def encoder(self) -> FrameEncoder:
        """As it is now."""

    def log_prob(self, frames: Tensor, act: Tensor) -> Tensor:
        """Of any actions [B, A] on seeing frames uint8 [B, stack, channels, height, width], float32 [B], nats."""


class RewardFunction(Stateful, Protocol):
    """A learned reward: what an ensemble says of each step, with or without a prior inside."""

    def begin(self, obs: Tensor) -> None:
        """Told of all observations so far, float32 [n, O], before the first training."""

    def members(self, segments: Segments) -> Tensor:
        """Reward of every step by every member, float32 [N, B, T], differentiable."""

    def predict(self, obs: Tensor, act: Tensor, prior: Tensor) -> Tensor:
        """Mean over the members, float32 [B], without gradient."""

    def parameters(self) -> list[Tensor]:
        """What an optimiser steps."""

    def penalty(self, rewards: Tensor, segments: Segments) -> Tensor:
        """What is added to a minibatch's loss, given what `members` said: summed over members, else averaged."""


class RewardLearner(Stateful, Protocol):
    """Trains a reward function from preferences; PEBBLE, SURF and MRN differ only behind this seam."""

    reward: RewardFunction
    needs: Needs

    def fit(self, feedback: Feedback) -> dict[str, float]:
        """One feedback session's worth of training on every label so far; `label_accuracy` and the like."""

    def refine(self, batch: Batch, agent: CriticAgent, feedback: Feedback) -> bool:
        """Called before updates of the agent (see `Needs`) after the first session; True when the reward changed."""

    def metrics(self) -> dict[str, float]:
        """Figures of the learner's own for the run's log, beside every evaluation; mostly none."""


class Feedback(Protocol):
    """What a learner is taught with: every labelled pair so far, and pairs nobody was asked about if it needs them.

    Segments are as long as the teacher's and the learner's margin on either side.
    """

    def __len__(self) -> int:
        """Labelled pairs."""

    def pairs(self, index: Tensor) -> tuple[Segments, Segments, Tensor]:
        """Pairs by position: both segments, and the probability float32 [B] that the second is preferred."""

    def newest(self) -> Tensor:
        """Positions of the newest labelled pairs, as many as a session asks for; fewer while there are fewer."""

    @property
    def unlabelled(self) -> int:
        """Pairs without a label."""

    def unlabelled_pairs(self, index: Tensor) -> tuple[Segments, Segments]:
        """Both segments of pairs without a label, by position."""


class SegmentRef(NamedTuple):
    """A segment of stored experience."""

    start: int  #: row of its first step
    length: int  #: steps


class Query(NamedTuple):
    """The question which of two segments is better."""

    id: str  #: sixteen hex digits that stand for what both show
    first: SegmentRef
    second: SegmentRef
    asked_at: int  #: environment step


class Answer(NamedTuple):
    """What a teacher says to a query."""

    query: str  #: its id
    preference: float  #: probability that the second is better: 0, 1, or 1/2 where they are equal; NaN: no answer


class Teacher(Stateful, Protocol):
    """Answers queries, at once or later. What it may see is handed to it when it is made: true rewards, or clips."""

    def ask(self, queries: Sequence[Query]) -> None:
        """Take queries; those that were open when a run was interrupted are put again."""

    def answers(self) -> list[Answer]:
        """What has arrived since the last call; never waits."""

    def observe_return(self, true_return: float, length: int) -> None:
        """Told of each finished training episode, for thresholds that follow the agent's level."""
