"""Several independent MLPs of one shape, stacked so that each layer is one batched matrix product.

The parameters of a stack lie in one flat buffer: an optimiser step or a Polyak average is then a single operation. A
stack is used in two ways. Calling it is ordinary differentiable code. `forward` and `backward_*` are the same equations
written out for training loops that want no autograd: they work in a reusable `Tape` and compute only the gradients
asked for. The tests compare the two, and both with `torch.nn.Linear`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Sequence

Activation = Literal["relu", "leaky_relu"]
Init = Literal["orthogonal", "torch"]

LEAK = 0.01  #: slope of leaky_relu below zero

#: Every parameter starts on a cache line, so that results do not depend on the sizes of its neighbours.
_ALIGN = 16


@dataclass
class Tape:
    """What one `forward` leaves for a backward pass, and room for the gradients on the way down."""

    inputs: Tensor  #: what the stack was given, [N, B, in]
    hidden: list[Tensor]  #: after the activation, [N, B, hidden] each
    outputs: Tensor  #: [N, B, out], stored as [N, out, B]
    deltas: tuple[Tensor, Tensor]  #: [N, B, hidden], used in turns


class StackedMLP:
    """`members` MLPs `inputs -> hidden (x layers) -> outputs`, without a non-linearity at the end.

    Args:
        members: networks in the stack, N.
        inputs, hidden, layers, outputs: the shape of each.
        generator: where the initial weights are drawn from, each member as a network of its own; None leaves them zero,
            for a stack that is about to be loaded or copied into.
        activation: of the hidden layers; leaky_relu has slope 0.01.
        init: `orthogonal` with gain 1 and zero biases (B-Pref's agent), or `torch`, `nn.Linear`'s own (its reward).
        device: where the parameters live; the generator must be of the same device.
    """

    def __init__(
        self,
        members: int,
        inputs: int,
        hidden: int,
        layers: int,
        outputs: int,
        *,
        generator: torch.Generator | None,
        activation: Activation = "relu",
        init: Init = "orthogonal",
        device: torch.device | str = "cpu",
    ) -> None:
        self.members = members
        self.widths = (inputs, *[hidden] * layers, outputs)
        self.activation = activation
        self.init = init
        shapes = [s for i, o in zip(self.widths, self.widths[1:], strict=False) for s in ((i, o), (1, o))]
        shapes[-2] = (outputs, self.widths[-2])
        size = sum(_padded(members * math.prod(shape)) for shape in shapes)
        self.flat = torch.zeros(size, device=device)  #: all parameters; the padding between them stays zero
        self.flat_grad = torch.zeros_like(self.flat)  #: their gradients, filled by `backward_params`
        self._params = self._windows(self.flat, shapes)
        self._grads = self._windows(self.flat_grad, shapes)
        self._leaves = [p.detach().requires_grad_() for p in self._params]
        if generator is not None:
            self.initialise(generator)

    def _windows(self, flat: Tensor, shapes: Sequence[tuple[int, int]]) -> list[Tensor]:
        """Views into a flat buffer, [N, *shape] each; the last weight is stored transposed, see `forward`."""
        views: list[Tensor] = []
        offset = 0
        for shape in shapes:
            size = self.members * math.prod(shape)
            views.append(flat[offset : offset + size].view(self.members, *shape))
            offset += _padded(size)
        views[-2] = views[-2].transpose(1, 2)
        return views

    def initialise(self, generator: torch.Generator) -> None:
        """Draw fresh weights in place."""
        for member in range(self.members):
            for weight, bias in zip(self._params[::2], self._params[1::2], strict=True):
                fan_in, fan_out = weight.shape[1:]
                drawn = torch.empty(fan_out, fan_in, device=weight.device)
                if self.init == "orthogonal":
                    nn.init.orthogonal_(drawn, generator=generator)
                    bias[member].zero_()
                else:
                    bound = 1 / math.sqrt(fan_in)
                    drawn.uniform_(-bound, bound, generator=generator)
                    bias[member].uniform_(-bound, bound, generator=generator)
                weight[member].copy_(drawn.t())

    def tape(self, batch: int) -> Tape:
        """A fresh tape for inputs of `batch` rows, to be used again and again."""

        def room(*shape: int) -> Tensor:
            return torch.empty(self.members, *shape, device=self.flat.device)

        return Tape(
            inputs=room(batch, 0),
            hidden=[room(batch, width) for width in self.widths[1:-1]],
            outputs=room(self.widths[-1], batch).transpose(1, 2),
            deltas=(room(batch, max(self.widths[1:-1], default=0)), room(batch, max(self.widths[1:-1], default=0))),
        )

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`: `[W0, b0, W1, b1, ...]`, W [N, in, out], b [N, 1, out]."""
        return self._leaves

    def __call__(self, x: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """Differentiable outputs.

        Args:
            x: float32 [B, in], the same for every member, or [N, B, in].
            params: used in place of the stack's own, same order and shapes as `parameters()`.

        Returns:
            float32 [N, B, out].
        """
        params = self._leaves if params is None else params
        h = x.expand(self.members, -1, -1)
        for weight, bias in zip(params[:-2:2], params[1:-2:2], strict=True):
            h = torch.baddbmm(bias, h, weight)
            h = torch.relu_(h) if self.activation == "relu" else nn.functional.leaky_relu_(h, LEAK)
        return torch.baddbmm(params[-1], h, params[-2])

    @torch.no_grad()
    def forward(self, x: Tensor, tape: Tape) -> Tensor:
        """Outputs [N, B, out] of x, [B, in] or [N, B, in], in the tape; x must not change before the backward pass."""
        tape.inputs = h = x.expand(self.members, -1, -1)
        for weight, bias, out in zip(self._params[:-2:2], self._params[1:-2:2], tape.hidden, strict=True):
            h = self._activate(torch.bmm(h, weight, out=out), bias)
        # The output is narrow, and matrix libraries are several times quicker when the narrow side comes first: the
        # last product, its weights and its gradient are computed transposed.
        weight, bias = self._params[-2:]
        torch.baddbmm(_t(bias), _t(weight), _t(h), out=_t(tape.outputs))
        return tape.outputs

    @torch.no_grad()
    def backward_params(self, grad: Tensor, tape: Tape) -> None:
        """Overwrite `flat_grad` with a loss' gradient, given its gradient [N, B, out] in the tape's outputs."""
        below = tape.hidden[-1] if tape.hidden else tape.inputs
        torch.bmm(_t(grad), below, out=_t(self._grads[-2]))
        torch.sum(grad, 1, keepdim=True, out=self._grads[-1])
        for layer in reversed(range(len(tape.hidden))):
            grad = self._descend(layer, grad, tape)
            below = tape.hidden[layer - 1] if layer > 0 else tape.inputs
            torch.bmm(_t(below), grad, out=self._grads[2 * layer])
            torch.sum(grad, 1, keepdim=True, out=self._grads[2 * layer + 1])

    @torch.no_grad()
    def backward_inputs(self, grad: Tensor, tape: Tape, columns: slice) -> Tensor:
        """Gradient in these columns of the tape's inputs, [N, B, columns], for each member by itself."""
        for layer in reversed(range(len(tape.hidden))):
            grad = self._descend(layer, grad, tape)
        return _t(torch.bmm(self._params[0][:, columns], _t(grad)))

    def _descend(self, layer: int, grad: Tensor, tape: Tape) -> Tensor:
        """The gradient in the product of a hidden layer, given that in the product of the layer above."""
        activated = tape.hidden[layer]
        delta = torch.bmm(grad, _t(self._params[2 * layer + 2]), out=tape.deltas[layer % 2])
        # Both activations keep the sign of their input, so their output tells on which side it was.
        if self.activation == "relu":
            torch.ops.aten.threshold_backward.grad_input(delta, activated, 0, grad_input=delta)
        else:
            torch.ops.aten.leaky_relu_backward.grad_input(delta, activated, LEAK, True, grad_input=delta)
        return delta

    def _activate(self, product: Tensor, bias: Tensor) -> Tensor:
        """Add the bias and apply the activation, in place; one pass over memory where there is one."""
        if self.activation == "leaky_relu":
            return nn.functional.leaky_relu_(product.add_(bias), LEAK)
        if product.device.type == "cpu":
            torch.ops.aten._add_relu_.Tensor(product, bias)
            return product
        return product.add_(bias).relu_()


def _t(stack: Tensor) -> Tensor:
    return stack.transpose(1, 2)


def _padded(size: int) -> int:
    return -(-size // _ALIGN) * _ALIGN
