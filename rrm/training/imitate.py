"""The share of demonstrations in a run: all of it for the run that trains a prior, the first phase of fine-tuning."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from rrm.buffers.experience import Experience
from rrm.imitation.airl import Airl
from rrm.imitation.demos import Demonstrations
from rrm.imitation.finetune import GradientLog
from rrm.interfaces import Floats, StochasticAgent
from rrm.seeding import Streams
from rrm.training.config import RunConfig
from rrm.training.evaluate import Evaluation
from rrm.types import Batch, State


class Imitation:
    """AIRL on its schedule.

    Args:
        config: of a run that begins with demonstrations.
        demos: of the expert.
        experience: of the policy.
        streams: see `rrm.imitation.airl.Airl`.
    """

    def __init__(self, config: RunConfig, demos: Demonstrations, experience: Experience, streams: Streams) -> None:
        self.gradients = GradientLog()  #: of g, where it is fine-tuned afterwards
        self._config = config
        self._experience = experience
        log = self.log if config.reward.is_learned else None
        self.airl = Airl(
            config.imitation, demos, config.agent.discount, streams, precision=config.precision, log=log
        )  # fmt: skip

    @property
    def step(self) -> int:
        """Of the run: every step is a transition."""
        return self._experience.transitions

    def log(self, loss: str, norm: float) -> None:
        """Record a gradient step of the present environment step."""
        self.gradients.add(self.step, loss, norm)

    @property
    def leads(self) -> bool:
        """True while demonstrations alone make the reward."""
        return not self._config.reward.is_learned or self.step < self._config.first_session

    def train(self, agent: StochasticAgent) -> None:
        """Train the discriminator against the agent, if it is due at this step."""
        since, imitation = self.step - self._config.random_steps, self._config.imitation
        if since >= 0 and since % imitation.every == 0:
            self.airl.train(
                lambda count, stream: self._experience.sample(count, stream, newest=imitation.window), agent
            )

    def reward(self, batch: Batch) -> Tensor:
        """What the agent is trained on, float32 [B]."""
        return self.airl.reward(batch)

    def look(self, obs: Floats, act: Floats, next_obs: Floats, *, terminated: bool) -> float:
        """The reward of one step as it is now, for the curve; what the agent learns from is taken anew later."""
        before, did, after = (torch.from_numpy(each)[None] for each in (obs, act, next_obs))
        blank, continues = torch.zeros(1), torch.tensor([0.0 if terminated else 1.0])
        return float(self.airl.look(Batch(before, did, blank, blank, after, continues)))

    def evaluated(self, result: Evaluation) -> None:
        """Keep g as it is if this evaluation is the best so far; only a run that trains a prior keeps any."""
        if not self._config.reward.is_learned:
            newest = self._experience.newest(self._config.imitation.window)
            self.airl.keep(self.step, result.success, result.true_return, newest)

    def publish(self, folder: Path) -> None:
        """Replace what is to be looked at beside the curve: the gradients of a reward that is fine-tuned."""
        if self._config.reward.is_learned:
            self.gradients.write(folder / "gradients.parquet")

    def prior(self) -> State | None:
        """The frozen prior that the run leaves behind; None where g was trained further."""
        if self._config.reward.is_learned:
            return None
        return {"task": self._config.task, "seed": self._config.seed, **self.airl.kept()}

    def state_dict(self) -> State:
        return {"airl": self.airl.state_dict(), "gradients": self.gradients.state_dict()}

    def load_state_dict(self, state: State) -> None:
        self.airl.load_state_dict(state["airl"])
        self.gradients.load_state_dict(state["gradients"])
