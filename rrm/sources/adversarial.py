"""The reward that demonstrations make: adversarial inverse reinforcement learning beside an agent (Fu et al. 2018;
appendix "Imitation rewards").

The agent is trained on f over its running standard deviation, taken anew for every batch it samples, so that no reward
is older than the discriminator; its own entropy term stands for -log pi. Policy transitions are uniform among the
newest. The density of a policy that has made up its mind is all but zero at what the expert does, and at what earlier
policies did: there f would be driven to minus thousands, and an expert be told by its density alone. So the density is
that of a policy with some uniform actions. What is kept is g as it was at the latest of the best evaluations: the final
one where that is at 100 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from rrm.imitation.discriminator import Discriminator, joined, on_device
from rrm.imitation.finetune import GradientLog
from rrm.losses import with_uniform
from rrm.moments import RunningMoments
from rrm.sources.base import RewardSource
from rrm.types import Batch

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from rrm.buffers.replay import Replay
    from rrm.config import ImitationConfig
    from rrm.imitation.demos import Demonstrations
    from rrm.interfaces import Agent
    from rrm.seeding import Streams
    from rrm.types import Evaluation, State, Transition


class Adversarial(RewardSource):
    """Demonstrations, discriminator, and what they leave behind: a prior, or the norms of g's gradients.

    Args:
        discriminator: of states, or of what a camera shows: what of a transition it looks at is its own affair.
        streams: `imitation` draws the minibatches.
        about: what to say of the prior that is left behind; None where g is trained further with preferences, and the
            norms of its gradients are what is left.
    """

    name = "adversarial"

    def __init__(
        self,
        config: ImitationConfig,
        demos: Demonstrations,
        replay: Replay,
        discriminator: Discriminator,
        *,
        streams: Streams,
        about: State | None,
    ) -> None:
        self._config = config
        self._replay = replay
        self._about = about
        self._demos = demos
        self.discriminator = discriminator
        self.gradients = GradientLog()
        self._generator = streams.torch("imitation")
        self.scale = RunningMoments()  #: of the reward that the agent was trained on, before it was divided by this
        self._kept: State | None = None

    def log(self, loss: str, norm: float) -> None:
        """Record a gradient step of the present environment step."""
        self.gradients.add(self._replay.steps, loss, norm)

    def attend(self, step: int, agent: Agent) -> None:
        """A round of gradient steps of the discriminator against the policy as it is, where one is due."""
        config, since = self._config, step - self._config.seed_steps
        if since < 0 or since % config.every:
            return
        for _ in range(config.updates):
            numbers = torch.randint(len(self._demos), (config.minibatch,), generator=self._generator)
            policy = self._replay.draw(config.minibatch, self._generator, newest=config.window)
            both = joined(self._shown(numbers), policy)
            log_prob = with_uniform(self.discriminator.density(agent, both), config.uniform, both.act.shape[1])
            norm = self.discriminator.step(both, log_prob)
            if self._about is None:
                self.log(config.pretrain, norm)

    def reward(self, step: Transition) -> float:
        """As it is now, for the curve; what the agent learns from is taken anew with every batch."""
        obs, act, next_obs = (torch.from_numpy(part)[None] for part in (step.obs, step.act, step.next_obs))
        blank, continues, frames = torch.zeros(1), torch.tensor([0.0 if step.terminated else 1.0]), None
        if step.frames is not None and step.next_frames is not None:
            frames = torch.from_numpy(np.concatenate((step.frames, step.next_frames[-1:])))[None]
        lived = Batch(obs, act, blank, blank, next_obs, continues, frames)
        return float(self.scale.over_std(self._raw(on_device(self.discriminator.device, lived))))

    def _shown(self, numbers: Tensor) -> Batch:
        """Transitions of the demonstrations, where the discriminator looks at them."""
        return on_device(self.discriminator.device, self._demos.batch(numbers))

    def batch(self, agent: Agent) -> Batch:  # noqa: ARG002 (the seam of others)
        """Transitions with their reward now; the deviation takes the batch in first."""
        batch = self._replay.sample()
        raw = self._raw(batch)
        values = raw.double()
        self.scale.add(float(values.mean()), float(values.var(correction=0)), values.numel())
        return batch._replace(reward=self.scale.over_std(raw))

    def _raw(self, batch: Batch) -> Tensor:
        return (self.discriminator.f if self._config.pretrain == "airl" else self.discriminator.reward)(batch)

    def evaluated(self, step: int, evaluation: Evaluation) -> None:
        """Keep g as it is, unless an earlier evaluation was better; the return decides where success is NaN.

        The range of g is recorded on the demonstrations and on the policy's newest transitions; its mean and deviation
        on both the demonstrations and the whole run, from random actions on: what a run on this prior will see. Of
        each there are as many as the discriminator looks at (`most`), evenly spread.
        """
        success = None if math.isnan(evaluation.success) else evaluation.success
        score = evaluation.true_return if success is None else success
        if self._about is None or (self._kept is not None and self._kept["score"] > score):
            return
        shown, lived = len(self._demos), self._replay.transitions
        newest = min(lived, self._config.window)
        demos = self._told(self._shown, 0, shown, shown)
        policy = self._told(self._replay.batch, lived - newest, newest, newest)
        run = self._told(self._replay.batch, 0, lived, shown)
        seen = torch.cat((demos, run)).double()
        self._kept = {
            "score": score, "step": step, "success": success, "true_return": evaluation.true_return,
            "range": {"demonstrations": _range(demos), "policy": _range(policy)},
            "mean": float(seen.mean()), "std": float(seen.std()), **self.discriminator.kept(),
        }  # fmt: skip

    def _told(self, batch: Callable[[Tensor], Batch], first: int, count: int, wanted: int) -> Tensor:
        """What g says of so many transitions by number, evenly among `count` from `first` on; some twice if fewer."""
        looks = min(wanted, self.discriminator.most)
        numbers = first + torch.arange(looks) * count // looks
        parts = torch.split(numbers, self.discriminator.at_once)
        return torch.cat([self.discriminator.reward(batch(part)) for part in parts])

    def legacy(self) -> State:
        """The frozen prior, where g was not trained further: its weights and shape, how good the policy was, and the
        demonstrations behind it.
        """
        if self._about is None:
            return {}
        assert self._kept is not None  # the last step of a run is evaluated
        kept = {name: value for name, value in self._kept.items() if name != "score"}
        described = {**self._about, **self.discriminator.described(), "demonstrations": self._demos.summary()}
        return {"imitation": described | kept}

    def publish(self, folder: Path) -> None:
        """The norms of the gradients, where g is trained further."""
        if self._about is None:
            self.gradients.write(folder / "gradients.parquet")

    def state_dict(self) -> State:
        scale = self.scale.state_dict()
        airl = {"discriminator": self.discriminator.state_dict(), "scale": scale, "kept": self._kept}
        return {"airl": airl, "gradients": self.gradients.state_dict()}

    def load_state_dict(self, state: State) -> None:
        airl = state["airl"]
        self.discriminator.load_state_dict(airl["discriminator"])
        self.scale.load_state_dict(airl["scale"])
        self._kept = airl["kept"]
        self.gradients.load_state_dict(state["gradients"])


def _range(values: Tensor) -> list[float]:
    """Smallest and largest."""
    low, high = torch.aminmax(values)
    return [float(low), float(high)]
