"""The reward that demonstrations make: AIRL on its schedule, and the prior or the gradients it leaves behind."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch

from rrm.imitation.airl import Airl
from rrm.imitation.finetune import GradientLog
from rrm.sources.base import RewardSource
from rrm.types import Batch

if TYPE_CHECKING:
    from pathlib import Path

    from rrm.buffers.replay import Replay
    from rrm.config import ImitationConfig
    from rrm.imitation.demos import Demonstrations
    from rrm.interfaces import Agent, StochasticAgent
    from rrm.precision import Precision
    from rrm.seeding import Streams
    from rrm.types import Evaluation, State, Transition


class Adversarial(RewardSource):
    """Discriminator against agent.

    Args:
        config: of the discriminator and its schedule.
        demos: of the expert.
        replay: of the policy.
        discount: of the agent.
        streams: see `rrm.imitation.airl.Airl`.
        precision: of products between hidden layers.
        about: what to say of the prior that is left behind; None where g is trained further with preferences, and the
            norms of its gradients are what is left.
    """

    name = "adversarial"

    def __init__(
        self,
        config: ImitationConfig,
        demos: Demonstrations,
        replay: Replay,
        *,
        discount: float,
        streams: Streams,
        precision: Precision,
        about: State | None,
    ) -> None:
        self.gradients = GradientLog()
        self._config = config
        self._replay = replay
        self._about = about
        log = self.log if about is None else None
        self.airl = Airl(config, demos, discount, streams, precision=precision, log=log)

    def log(self, loss: str, norm: float) -> None:
        """Record a gradient step of the present environment step: every step is a transition."""
        self.gradients.add(self._replay.transitions, loss, norm)

    def reward(self, step: Transition) -> float:
        """As it is now, for the curve; what the agent learns from is taken anew with every batch."""
        obs, act, next_obs = (torch.from_numpy(part)[None] for part in (step.obs, step.act, step.next_obs))
        blank, continues = torch.zeros(1), torch.tensor([0.0 if step.terminated else 1.0])
        return float(self.airl.look(Batch(obs, act, blank, blank, next_obs, continues)))

    def attend(self, step: int, agent: Agent) -> None:
        """Train the discriminator, if it is due."""
        since = step - self._config.seed_steps
        if since >= 0 and since % self._config.every == 0:
            window = self._config.window
            self.airl.train(
                lambda count, stream: self._replay.draw(count, stream, newest=window), cast("StochasticAgent", agent)
            )

    def batch(self, agent: Agent) -> Batch:  # noqa: ARG002 (the seam of others)
        batch = self._replay.sample()
        return batch._replace(reward=self.airl.reward(batch))

    def evaluated(self, step: int, evaluation: Evaluation) -> None:
        """Keep g as it is if this evaluation is the best so far."""
        if self._about is not None:
            newest = self._replay.newest(self._config.window)
            self.airl.keep(step, evaluation.success, evaluation.true_return, newest)

    def legacy(self) -> State:
        """The frozen prior, where g was not trained further."""
        return {} if self._about is None else {"imitation": {**self._about, **self.airl.kept()}}

    def publish(self, folder: Path) -> None:
        """The norms of the gradients, where g is trained further."""
        if self._about is None:
            self.gradients.write(folder / "gradients.parquet")

    def state_dict(self) -> State:
        return {"airl": self.airl.state_dict(), "gradients": self.gradients.state_dict()}

    def load_state_dict(self, state: State) -> None:
        self.airl.load_state_dict(state["airl"])
        self.gradients.load_state_dict(state["gradients"])
