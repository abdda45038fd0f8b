"""The shapes that travel between the rooms, written once.

Axes: `B` batch, `T` time inside a segment, `N` ensemble member, `O` observation, `A` action.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from torch import Tensor

Floats = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8]

#: What `state_dict` returns: nested dicts and lists of tensors, numpy arrays and JSON values. No other objects, so that
#: a checkpoint can be written without a pickle.
State = dict[str, Any]


class Obs(NamedTuple):
    """What an agent acts on."""

    state: Floats  #: [O]
    frames: Pixels | None = None  #: the newest ones [stack, channels, height, width] on tasks with a camera


class Batch(NamedTuple):
    """Transitions for one agent update. It has no true reward: that column is read by teachers and evaluation alone.

    Agents that see frames get windows of T consecutive steps of an episode: `B` is then `B, T`, but for the frames.
    Those of a transition are as of T = 1.
    """

    obs: Tensor  #: float32 [B, O]
    act: Tensor  #: float32 [B, A], in [-1, 1]
    prior: Tensor  #: float32 [B], the scaled prior r0 stored at collection; zeros without a prior
    reward: Tensor  #: float32 [B], what the agent is trained on
    next_obs: Tensor  #: float32 [B, O]
    continues: Tensor  #: float32 [B], 0 where the task terminated (a time limit is not a termination), else 1
    frames: Tensor | None = None  #: uint8 [B, stack + T, channels, height, width]: the stack at the first step, and on


class Segments(NamedTuple):
    """Consecutive steps of one episode each, as a reward learner sees them."""

    obs: Tensor  #: float32 [B, T, O]
    act: Tensor  #: float32 [B, T, A]
    prior: Tensor  #: float32 [B, T], r0 as stored at collection


class Transition(NamedTuple):
    """One environment step as it was lived. Sources of rewards see it; agents and learners see batches."""

    obs: Floats  #: [O]
    act: Floats  #: [A], in [-1, 1]
    next_obs: Floats  #: [O]
    prior: float  #: scaled, r0; 0 without a prior
    raw_prior: float
    true_reward: float
    terminated: bool  #: cuts the bootstrap
    truncated: bool  #: a time limit, which does not
    frames: Pixels | None = None  #: seen at `obs`, [stack, channels, height, width] on tasks with a camera
    next_frames: Pixels | None = None  #: at `next_obs`


class Evaluation(NamedTuple):
    """What a policy is worth: means over the episodes."""

    true_return: float
    success: float  #: share of the episodes; NaN where the task has no success criterion


@dataclass(frozen=True, kw_only=True)
class EvalRow:
    """One evaluation: a row of a run's curve. Success is a fraction, times are seconds, steps are environment steps."""

    step: int  #: environment steps taken when the policy was evaluated
    episodes: int  #: evaluation episodes behind this row
    true_return: float  #: mean undiscounted return of the true reward
    success: float  #: share of episodes with success (`evaluation.success`); NaN for tasks without such a criterion
    queries: int  #: queries put to the teacher so far, skipped ones included
    labels: int  #: labels kept so far
    prior_mean: float  #: mean of r0 over the transitions since the last row; NaN without a prior
    residual_mean: float  #: mean of (reward - r0) over those transitions; NaN without a prior
    reward_mean: float  #: mean of the reward the agent was given for those transitions
    reward_std: float  #: its standard deviation
    true_reward_mean: float  #: mean true reward of those transitions
    wall_s: float  #: training time so far, interruptions left out
    steps_per_s: float  #: environment steps per second since the last row, evaluation included
    figures: dict[str, float] = field(default_factory=dict)  #: what agent and sources of rewards say of themselves

    def columns(self) -> dict[str, float]:
        """Every number by its name, those of the figures behind the others."""
        row = asdict(self)
        figures: dict[str, float] = row.pop("figures")
        return row | {name: float(value) for name, value in figures.items()}
