"""Adam over one flat tensor: a whole network is updated by a single fused operation."""

from __future__ import annotations

import torch
from torch import Tensor

from rrm.types import State


class FlatAdam:
    """Adam (betas 0.9 and 0.999, epsilon 1e-8, no weight decay) for one tensor and the buffer its gradient lies in.

    The operation is the one behind `torch.optim.Adam(fused=True)`, called directly: the class around it costs as much
    time as the update of a small network.
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
        self._steps += 1
        torch._fused_adam_(
            [self.param], [self.grad], [self._mean], [self._square], [], [self._steps],
            lr=self.lr, beta1=0.9, beta2=0.999, weight_decay=0.0, eps=1e-8, amsgrad=False, maximize=False,
        )  # fmt: skip

    def reset(self) -> None:
        for moment in (self._mean, self._square, self._steps):
            moment.zero_()

    def state_dict(self) -> State:
        """Both moments and the number of steps; the parameters belong to their network."""
        return {"mean": self._mean.clone(), "square": self._square.clone(), "steps": self._steps.clone()}

    def load_state_dict(self, state: State) -> None:
        self._mean.copy_(state["mean"])
        self._square.copy_(state["square"])
        self._steps.copy_(state["steps"])
