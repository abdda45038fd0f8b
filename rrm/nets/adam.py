"""Adam over one flat tensor: a whole network is updated by a single fused operation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim.adam import adam

from rrm.types import State


class FlatAdam:
    """Adam (betas 0.9 and 0.999, epsilon 1e-8, no weight decay) for one tensor and the buffer its gradient lies in.

    The arithmetic is `torch.optim.Adam`'s; the class around it costs as much as the update of a small network, so the
    function behind it is called directly.
    """

    def __init__(self, param: Tensor, grad: Tensor, lr: float) -> None:
        """Args: param, grad: float32 of one shape, updated and read in place; lr: step size."""
        self.param = param
        self.grad = grad
        self.lr = lr
        self._mean = torch.zeros_like(param)
        self._square = torch.zeros_like(param)
        self._steps = torch.zeros((), device=param.device)

    @torch.no_grad()
    def step(self) -> None:
        """One step along the gradient now in the buffer."""
        adam(
            [self.param],
            [self.grad],
            [self._mean],
            [self._square],
            [],
            [self._steps],
            fused=True,
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=self.lr,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )

    def reset(self) -> None:
        """Forget every gradient seen."""
        for moment in (self._mean, self._square, self._steps):
            moment.zero_()

    def state_dict(self) -> State:
        """Both moments and the number of steps; the parameters belong to their network."""
        return {"mean": self._mean.clone(), "square": self._square.clone(), "steps": self._steps.clone()}

    def load_state_dict(self, state: State) -> None:
        """Continue where `state_dict` was taken."""
        self._mean.copy_(state["mean"])
        self._square.copy_(state["square"])
        self._steps.copy_(state["steps"])
