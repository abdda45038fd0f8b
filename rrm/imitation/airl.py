"""Adversarial inverse reinforcement learning beside an agent (Fu et al. 2018; appendix "Imitation rewards").

The agent is trained on f over its running standard deviation, taken anew for every batch it samples, so that no reward
is older than the discriminator; its own entropy term stands for -log pi. Policy transitions are uniform among the
newest. What is kept is g as it was at the latest of the best evaluations: the final one where that is at 100 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from rrm.config import ImitationConfig
from rrm.imitation.discriminator import Discriminator, RewardNet
from rrm.moments import RunningMoments
from rrm.types import Batch, State

if TYPE_CHECKING:
    from rrm.imitation.demos import Demonstrations
    from rrm.interfaces import StochasticAgent
    from rrm.precision import Precision
    from rrm.seeding import Streams

_ROWS_AT_ONCE = 2048  #: of a forward pass, whose memory is kept

#: Draws that many of the policy's newest transitions from this stream.
Draw = Callable[[int, torch.Generator], Batch]


class Airl:
    """Demonstrations, discriminator, and the reward they make.

    Args:
        discount: of the agent.
        streams: `imitation-init` draws weights, `imitation` the minibatches.
        log: told of every gradient step: the loss' name, and the norm of the gradient in g's weights.
    """

    def __init__(
        self,
        config: ImitationConfig,
        demos: Demonstrations,
        discount: float,
        streams: Streams,
        *,
        precision: Precision = "float32",
        log: Callable[[str, float], None] | None = None,
    ) -> None:
        self.config = config
        self._sizes = (demos.obs.shape[1], demos.act.shape[1])
        self.discriminator = Discriminator(
            config, *self._sizes, discount, generator=streams.torch("imitation-init"), precision=precision
        )
        self._summary = demos.summary()
        self._expert = _batch(demos)
        self._generator = streams.torch("imitation")
        self._scale = RunningMoments()
        self._log = log
        self._kept: State | None = None

    def train(self, draw: Draw, agent: StochasticAgent) -> None:
        """One round of gradient steps against the policy as it is."""
        for _ in range(self.config.updates):
            rows = torch.randint(len(self._expert.obs), (self.config.minibatch,), generator=self._generator)
            expert = Batch(*(column[rows] for column in self._expert if column is not None))
            policy = draw(self.config.minibatch, self._generator)
            log_prob = agent.log_prob(torch.cat((expert.obs, policy.obs)), torch.cat((expert.act, policy.act)))
            norm = self.discriminator.step(expert, policy, log_prob)
            if self._log is not None:
                self._log(self.config.pretrain, norm)

    def reward(self, batch: Batch) -> Tensor:
        """What the agent is trained on, float32 [B]; the deviation takes the batch in first."""
        raw = self._raw(batch)
        values = raw.double()
        self._scale.add(float(values.mean()), float(values.var(correction=0)), len(values))
        return raw / (self._scale.std or 1.0)

    def look(self, batch: Batch) -> Tensor:
        """The reward of these transitions at this moment, float32 [B]; nothing is learned from looking."""
        return self._raw(batch) / (self._scale.std or 1.0)

    def _raw(self, batch: Batch) -> Tensor:
        if self.config.pretrain == "mse":
            return self.discriminator.g.predict(batch.obs, batch.act)
        return self.discriminator.f(batch)

    def keep(self, step: int, success: float, true_return: float, newest: Batch) -> None:
        """Keep g as it is, unless an earlier evaluation was better; the return decides where success is NaN.

        The range of g is recorded on the demonstrations and on the policy's `newest` transitions.
        """
        score = true_return if math.isnan(success) else success
        if self._kept is not None and self._kept["score"] > score:
            return
        g = self.discriminator.g
        ranges = {"demonstrations": _range(g, self._expert), "policy": _range(g, newest)}
        self._kept = {
            "score": score, "step": step, "success": None if math.isnan(success) else success,
            "true_return": true_return, "range": ranges, "g": g.net.flat.clone(),
        }  # fmt: skip

    def kept(self) -> State:
        """The frozen prior: g's weights, its shape, how good the policy was, and the demonstrations behind it."""
        assert self._kept is not None  # the last step of a run is evaluated
        shape: dict[str, Any] = {name: getattr(self.config, name) for name in ("hidden", "layers", "head")}
        obs_dim, act_dim = self._sizes
        kept = {name: value for name, value in self._kept.items() if name != "score"}
        return {"shape": shape, "obs_dim": obs_dim, "act_dim": act_dim, "demonstrations": self._summary, **kept}

    def state_dict(self) -> State:
        scale = self._scale.state_dict()
        return {"discriminator": self.discriminator.state_dict(), "scale": scale, "kept": self._kept}

    def load_state_dict(self, state: State) -> None:
        self.discriminator.load_state_dict(state["discriminator"])
        self._scale.load_state_dict(state["scale"])
        self._kept = state["kept"]


def _range(g: RewardNet, batch: Batch) -> list[float]:
    """Smallest and largest reward of the transitions."""
    parts = zip(*(torch.split(column, _ROWS_AT_ONCE) for column in (batch.obs, batch.act)), strict=True)
    low, high = torch.aminmax(torch.cat([g.predict(obs, act) for obs, act in parts]))
    return [float(low), float(high)]


def _batch(demos: Demonstrations) -> Batch:
    """All transitions; the columns that demonstrations lack are zero."""
    obs, act, next_obs = (torch.from_numpy(array.copy()) for array in (demos.obs, demos.act, demos.next_obs))
    blank = torch.zeros(len(demos))
    return Batch(obs, act, blank, blank, next_obs, 1.0 - torch.from_numpy(demos.terminated.astype("float32")))
