"""MRN: PEBBLE, and now and then a step of the reward along what its critic would make of it (Liu et al. 2022).

The critic takes one imaginary step of plain gradient descent on the reward as it is; the reward is then moved so that
the Q-values after that step agree better with the newest labels (the imaginary step stays in the graph).

    theta+(psi) = theta - lr * d/d theta [MSE(Q1, y) + MSE(Q2, y)],     y = r_psi + discount * continues * V
    outer(psi)  = weight * [CE(Q1+) + CE(Q2+)],     log-odds Q+(first step of segment 1) - Q+(first step of segment 0)

Departures from the authors' code: a time limit does not cut the bootstrap unless `faithful_done` asks for it, pairs
called equal have the target one half, and while there are fewer labels than a session asks for, those there are serve.
The squared penalty of a gaussian residual belongs to the fit of the labels and is no part of the outer loss.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from rrm.config import RewardConfig
from rrm.interfaces import CriticAgent, Feedback, RewardFunction
from rrm.losses import preference_loss
from rrm.rewards.pebble import Pebble, adam_state, load_adam_state
from rrm.types import Batch, Segments, State


class Mrn(Pebble):
    """PEBBLE's sessions, and `refine` between them; `reward.mrn` holds its settings."""

    def __init__(self, reward: RewardFunction, config: RewardConfig, rng: np.random.Generator) -> None:
        super().__init__(reward, config, rng)
        mrn = config.mrn
        self.needs = mrn.needs()
        self._own = torch.optim.Adam(reward.parameters(), lr=config.lr, fused=True)  # of the option "separate"
        self._meta_optimizer = self._own if mrn.meta_optimizer == "separate" else self._optimizer
        self._figures = torch.full((2,), float("nan"))
        self._steps = 0

    def refine(self, batch: Batch, agent: CriticAgent, feedback: Feedback) -> bool:
        """One step of the reward on the outer loss; False while there is no label."""
        if not len(feedback):
            return False
        parameters = self.reward.parameters()
        gradients = torch.autograd.grad(self.outer_loss(batch, agent, feedback), parameters)
        before = _flat(parameters)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
        self._meta_optimizer.step()
        self._meta_optimizer.zero_grad(set_to_none=True)
        uphill = _flat(gradients)
        cosine = torch.cosine_similarity(before - _flat(parameters), uphill, dim=0, eps=0.0)
        self._figures = torch.stack((uphill.norm(), cosine))
        self._steps += 1
        return True

    def outer_loss(self, batch: Batch, agent: CriticAgent, feedback: Feedback) -> Tensor:
        """How badly critics one step ahead tell the newest labels; a scalar, differentiable in the reward's parameters.

        The imaginary step is taken on `batch`, whose reward is not looked at; the agent's critics stay as they are.
        """
        params = agent.critic_parameters()
        steps = Segments(*(field.unsqueeze(0) for field in (batch.obs, batch.act, batch.prior)))
        rewards = self.reward.members(steps).mean(dim=0).squeeze(0)
        q_target = agent.q_target(batch._replace(reward=rewards))
        error = agent.q_values(batch.obs, batch.act, params) - q_target
        gradients = torch.autograd.grad(error.square().mean(dim=-1).sum(), params, create_graph=True)
        ahead = [p - agent.critic_lr * g for p, g in zip(params, gradients, strict=True)]
        first, second, target = feedback.pairs(feedback.newest())
        q_first, q_second = (agent.q_values(s.obs[:, 0], s.act[:, 0], ahead) for s in (first, second))
        return self.config.mrn.outer_weight * preference_loss(q_second - q_first, target)

    def metrics(self) -> dict[str, float]:
        """Norm of the last outer gradient, cosine of its descent and Adam's step (NaN before), and their number."""
        norm, cosine = self._figures.tolist()
        return {"meta_gradient": norm, "meta_cosine": cosine, "meta_steps": float(self._steps)}

    def state_dict(self) -> State:
        own = {"meta_optimizer": adam_state(self._own), "figures": self._figures.clone(), "steps": self._steps}
        return super().state_dict() | own

    def load_state_dict(self, state: State) -> None:
        super().load_state_dict(state)
        load_adam_state(self._own, state["meta_optimizer"])
        self._figures = state["figures"].clone()
        self._steps = int(state["steps"])


def _flat(tensors: tuple[Tensor, ...] | list[Tensor]) -> Tensor:
    return torch.cat([tensor.detach().reshape(-1) for tensor in tensors])
