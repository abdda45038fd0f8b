"""Adam over one flat tensor: a whole network is updated by a single operation."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from rrm.nets.compiled import ADAM
from rrm.nets.program import Coded
from rrm.types import State

_BETAS, _EPSILON = (0.9, 0.999), 1e-8

#: A card's kernel works on so many tensors at a time, and on a single one with a few blocks of threads alone: the flat
#: tensor is handed to it in so many pieces.
_PIECES = 32


class FlatAdam:
    """Adam (betas 0.9 and 0.999, epsilon 1e-8, no weight decay) for one tensor and the buffer its gradient lies in."""

    def __init__(self, param: Tensor, grad: Tensor, lr: float) -> None:
        """Args: param, grad: float32 of one shape, updated and read in place; lr: step size."""
        self.param = param
        self.grad = grad
        self.lr = lr
        self._mean = torch.zeros_like(param)
        self._square = torch.zeros_like(param)
        self._steps = 0  # on a processor; a card counts for itself, so that nobody has to tell it
        self._counted = torch.zeros((), device=param.device)
        self._factors = np.zeros(2, np.float32)  # step size and root, both with the bias of the moments taken out
        places = [part.data_ptr() for part in (param, grad, self._mean, self._square)]
        piece = -(-param.numel() // (4 * _PIECES)) * 4  # begins where four numbers are read at a time
        self._pieces = [torch.split(tensor, piece) for tensor in (param, grad, self._mean, self._square)]
        self._work = Coded([(ADAM, *places, param.numel(), self._factors.ctypes.data)], self)

    @torch.no_grad()
    def step(self) -> None:
        """One step along the gradient now in the buffer."""
        if self.param.device.type == "cpu":
            self._steps += 1
            first, second = (1 - beta**self._steps for beta in _BETAS)
            self._factors[:] = self.lr / first, 1 / math.sqrt(second)
            self._work()
            return
        self._counted += 1
        params, grads, means, squares = self._pieces
        torch._fused_adam_(
            params, grads, means, squares, [], [self._counted] * len(params),
            lr=self.lr, beta1=_BETAS[0], beta2=_BETAS[1], weight_decay=0.0, eps=_EPSILON, amsgrad=False, maximize=False,
        )  # fmt: skip

    def reset(self) -> None:
        self._mean.zero_()
        self._square.zero_()
        self._count(0)

    def _count(self, steps: int) -> None:
        self._steps = steps
        self._counted.fill_(steps)

    @property
    def changed(self) -> list[Tensor]:
        """Everything that a step on a card changes."""
        return [self.param, self._mean, self._square, self._counted]

    def state_dict(self) -> State:
        """Both moments and the number of steps; the parameters belong to their network."""
        steps = torch.tensor(float(self._steps)) if self.param.device.type == "cpu" else self._counted.clone()
        return {"mean": self._mean.clone(), "square": self._square.clone(), "steps": steps}

    def load_state_dict(self, state: State) -> None:
        self._mean.copy_(state["mean"])
        self._square.copy_(state["square"])
        self._count(int(state["steps"]))
